"""A bus live: frames decoded, watched, described."""
