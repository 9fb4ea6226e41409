"""Bus schedulability of a rig: response times, the worst cycle, its plot."""
