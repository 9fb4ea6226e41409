"""Host, bus, nodes and rig put together: simulate, demo, figures and their measures."""
