"""What each benchmark times, against what, and why that reference is fair."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["BESIDE", "SENTENCES"]

SENTENCES: Mapping[str, str] = {
    "virtual": "The whole stack in virtual time against real time, and against the bare co-simulation of the same "
    "plant, host and PDOs, which exchanges them by function calls and so shows what nodes and bus cost.",
    "first": "Processor time of a cold and of a warm start, against numba compiling one reference kernel and against "
    "its import, which take turns with the starts on the same machine.",
    "detail": "Virtual time with the detailed plant, against real time and in turns with the plain plant.",
    "sweep": "A run of a sweep against its cycles alone, and two processes against one, beside two processes of cycles "
    "alone, which show what the processors give.",
    "network": "The cost of a frame with 2 to 126 nodes against the cheapest of them, each at the same bus load.",
    "bus": "Virtual time with noise on the bus, in turns with the same run without noise.",
    "eds": "Reading a large EDS file, in turns with canopen's reader of the same file.",
    "nodes": "A node's SDO services, in turns with canopen's LocalNode for the same requests, and against the bus's rate.",
    "exports": "Export of a recording against its length, and against python-can's writers of the same formats.",
    "clients": "Processor time of each client at 10,000 frames/s, against python-can's recv of the same frames.",
    "page": "Processor time of the page's server, against python-can's recv of the same bus.",
    "world": "A program's states and models at a running display, in turns with a bare socket, and the cycle "
    "with four programs in turns with none.",
    "faulty": "Delivery of frames while 1 % are destroyed, in turns with cyclictest at the same priority.",
    "realtime": "The cycle's wake-up and processor time, in turns with cyclictest and with the same loop in C.",
}
"""The benchmarks of ``make bench``, in their order: figures of the processor first, the long ones last."""

BESIDE = ("bits", "coverage", "loss", "lost", "disturbed", "observers", "releases", "worlds")
"""Those that run only when named: they take up to an hour."""
