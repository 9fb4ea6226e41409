"""Host and virtual bus together: simulate, replay, demo."""
