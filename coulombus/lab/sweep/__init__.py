"""Many runs of rigs and hands that differ: planned, carried out, kept, counted."""
