"""Whether a rig's frames fit into its cycle: response times, the worst cycle, its picture."""
