"""Pictures of recordings, and the one style of all figures."""
