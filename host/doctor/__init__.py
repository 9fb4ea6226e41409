"""Checks of a rig's PC, each with the command that fixes the problem.

Each module has the checks of one subject. They read the machine through `machine.Machine`, which tests
replace by a tree of files. No check changes anything.
"""
