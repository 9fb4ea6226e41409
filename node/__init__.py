"""A CANopen device: frames and time in, frames and the next deadline out.

It has a compiled core and Python services.
"""
