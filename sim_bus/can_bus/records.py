"""The records of the copper by name, for signatures.

Their fields are those of `arbiter.BUS`, `controller.CONTROLLER` and `faults.FAULT`; mypy knows none
of them.
"""

from __future__ import annotations

from typing import Any, TypeAlias

__all__ = ["BusRecord", "ControllerRecord", "FaultRecord"]

BusRecord: TypeAlias = Any
"""The wire with all that hangs on it: a record of `arbiter.BUS`."""
ControllerRecord: TypeAlias = Any
"""The CAN controller of a station: a record of `controller.CONTROLLER`."""
FaultRecord: TypeAlias = Any
"""A fault that is planned: a record of `faults.FAULT`."""
