"""The rig file: its model, axes, rules and signals; the packaged rigs."""
