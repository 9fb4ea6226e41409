"""Host and virtual bus together: simulate, sweep, replay, demo."""
