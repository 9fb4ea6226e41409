"""Conformance test of CANopen devices: cases of CiA 301, 305 and 402 on one live node over its bus."""
