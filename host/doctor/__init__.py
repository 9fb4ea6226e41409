"""What is wrong with a rig's PC, and how it is mended.

Each module has the checks of one subject. They read the machine through `machine.Machine`, which
tests replace by a tree of files; no check changes anything.
"""
