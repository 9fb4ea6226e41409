"""Commissioning: step by step from a rig file with assumed values to one with measured values.

A step moves the rig by an exercise (`host.laws.exercises`): a law that runs in the same cycle, with the
same limits and monitors, as any other law, in an ordinary recorded run. The findings of a step are a
function of that recording. So a step is the same on a rig, on `coulombus emulate` and in virtual time.
"""
