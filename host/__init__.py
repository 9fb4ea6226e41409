"""All that runs on the rig's PC: bring-up, the cycle, the laws, the data plane, the course of a
run.
"""
