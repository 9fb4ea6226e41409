"""Commissioning: step by step from a rig file that believes to one that was measured.

A step moves the rig by an exercise (`host.laws.exercises`): a law that goes through the same cycle,
limits and watches as any other, in an ordinary run that is recorded. What the step finds is a
function of that recording. So a step is the same on a rig, on `coulombus emulate` and in virtual time.
"""
