"""A conformance run of CANopen devices: cases of CiA 301, 305 and 402 that drive one live node over
its bus.
"""
