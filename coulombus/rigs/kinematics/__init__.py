"""Planar kinematics of a rig's joints: [kinematics], compiled mechanisms, their checks; no forces."""
