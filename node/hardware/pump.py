"""Loop between a node's core and its converters: one call per period, in the bus's thread.

Read all inputs into the core, and write the core's outputs. After any failure all outputs take
their safe values, the node sends EMCY 5000h and reacts as to a device fault (1029h:02 determines
its NMT state), and the outputs stay safe until "reset node" or "reset communication". Then, and at
the start, the safe values must be written and read back, and all inputs must be read, before
anything else is output.

The time is an argument, so the tests run in virtual time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from coulombus.eds.cia301 import DATA_TYPES, NmtState
from coulombus.node import emcy
from coulombus.node.device import Device
from coulombus.node.hardware import channels
from coulombus.node.hardware.board import Board, BoardInput, BoardOutput
from coulombus.node.hardware.channels import (
    Claim,
    HardwareError,
    Input,
    Output,
    PwmOutput,
    SafeWrite,
    counter,
    find,
    finite,
    iio,
)
from coulombus.node.hardware.iio_buffer import BufferedInput, IioBuffer, NoBuffer
from coulombus.node.hardware.io_file import CounterInput, IioInput, IioOutput, IoPlan, Line
from coulombus.node.hardware.io_file import PwmOutput as PwmChannel

__all__ = ["Pump", "Watched"]

_BIT = 1 << emcy.HARDWARE - emcy.FIRST_DEVICE_CAUSE
RETRY_NS = 100_000_000
"""Interval at which the safe values are written again while the hardware has failed."""


class Watched(Protocol):
    """Interface of `node.hardware.watchdog.Guard`."""

    def feed(self) -> None:
        """Report that the node is alive; HardwareError if the watchdog has acted, or is gone."""

    def close(self) -> None:
        """Make the outputs safe a last time."""


@dataclass
class _End:
    """A channel with its settings in the file."""

    line: Line
    channel: Output
    safe_raw: float = 0.0
    claim: Claim | None = None

    def raw(self, value: float) -> float:
        """Return the channel's raw number for a value."""
        settings = self.line.channel
        return settings.raw_at_zero + settings.raw_per_unit * min(max(value, settings.low), settings.high)


@dataclass
class Pump:
    """The converters of one node.

    Parameters
    ----------
    plan : content of the I/O file
    guard : returns the watchdog for its time, the safe writes of the outputs, and the claims'
        descriptors
    report : called with a line for people when the hardware fails, and when it works again
    """

    plan: IoPlan
    guard: Callable[[float, Sequence[SafeWrite], Sequence[int]], Watched]
    report: Callable[[str], None]
    failure: str = ""
    """Reason why only the safe values are output; empty: no failure."""
    periods: int = 0
    skipped: int = 0
    """Number of periods skipped because reading and writing took longer."""
    _outputs: list[_End] = field(default_factory=list)
    _inputs: list[tuple[Line, Input]] = field(default_factory=list)
    _buffers: dict[str, IioBuffer] = field(default_factory=dict)
    _board: Board | None = None
    _watchdog: Watched | None = None
    _device: Device | None = None
    _boots: int = 0
    _retry_ns: int = 0

    @property
    def period_ns(self) -> int:
        """Time from one call of `period` to the next."""
        return round(self.plan.file.loop.period_s * 1e9)

    # life cycle

    def open(self) -> None:
        """Find all channels, claim the outputs, write and read back the safe values, read every input,
        start the watchdog.

        Raises
        ------
        HardwareError
            a step failed; the outputs reached so far are safe
        """
        try:
            self._find()
            orders = [order for end in self._outputs for order in end.channel.orders(end.safe_raw)]
            claims = [end.claim.descriptor for end in self._outputs if end.claim is not None]
            self._watchdog = self.guard(self.plan.file.loop.watchdog_s, orders, claims)
            self._begin()
        except BaseException:
            self.close()
            raise

    def attach(self, device: Device) -> None:
        """Attach the device whose core is served, before it is switched on."""
        self._device = device
        for line in (output.line for output in self._outputs):
            wire, settings = line.terminal, line.channel
            if wire is None:
                continue
            for name, bound in ((wire.low, math.ceil(settings.low)), (wire.high, math.floor(settings.high))):
                if name:
                    if wire.k < 0:
                        device.record[name] = settings.high
                    else:
                        device.record[name][wire.k] = bound
        if self.plan.file.brake.coil_A_Nm:
            device.record["coil_A_Nm"] = self.plan.file.brake.coil_A_Nm

    def close(self) -> None:
        """Make the outputs safe and release them; the watchdog makes them safe once more."""
        self._make_safe()
        if self._watchdog is not None:
            self._watchdog.close()
            self._watchdog = None
        for buffer in self._buffers.values():
            buffer.close()
        for end in self._outputs:
            if end.claim is not None:
                end.claim.close()
                end.claim = None

    # the loop

    def period(self, t_ns: int) -> None:
        """Feed the watchdog, read the inputs, write the outputs; never raises."""
        self.periods += 1
        device = self._device
        assert device is not None
        try:
            assert self._watchdog is not None
            self._watchdog.feed()
            if self.failure:
                if device.boots == self._boots:
                    self._wait(t_ns)
                    return
                self._begin()
                self._recovered(device, t_ns)
            self._boots = device.boots
            self._read(device, t_ns)
            self._write(device)
        except HardwareError as error:
            self._fail(device, t_ns, str(error))
        except Exception as error:  # an internal error must not leave an output at its last value
            self._fail(device, t_ns, repr(error))

    def _read(self, device: Device, t_ns: int) -> None:
        if self._board is not None:
            self._board.refresh()
        for buffer in self._buffers.values():
            buffer.refresh(t_ns)
        changed = False
        for line, channel in self._inputs:
            value, wire = self._value(line, channel), line.terminal
            if wire is None:
                changed |= _set_object(device, line, value)
            elif wire.k < 0:
                device.record[wire.field] = value
            else:
                changed |= bool(device.record[wire.field][wire.k] != round(value))
                device.record[wire.field][wire.k] = round(value)
        if changed and device.record["powered"]:
            device.record["next_ns"] = min(int(device.record["next_ns"]), t_ns)

    @staticmethod
    def _value(line: Line, channel: Input) -> float:
        settings = line.channel
        value = (finite(channel.read(), line.where) - settings.raw_at_zero) / settings.raw_per_unit
        if not settings.low <= value <= settings.high:
            object_ = f"{line.key[0]:04X}h:{line.key[1]:02X}"
            raise HardwareError(f"{line.where}: {object_} is {value:g}, expected {settings.low:g} to {settings.high:g}")
        return value

    def _write(self, device: Device) -> None:
        for end in self._outputs:
            wire = end.line.terminal
            if wire is not None:
                number = device.record[wire.field]
                end.channel.write(end.raw(float(number if wire.k < 0 else number[wire.k])))
            elif device.record["powered"] and device.record["nmt"] == NmtState.OPERATIONAL:
                value = device.dictionary[end.line.key]
                end.channel.write(end.raw(finite(value, end.line.where)))
            else:
                end.channel.write(end.safe_raw)

    # faults

    def _fail(self, device: Device, t_ns: int, why: str) -> None:
        failure = self._make_safe()
        is_new = why != self.failure or device.boots != self._boots  # a reset without effect is reported, too
        self._boots, self._retry_ns = device.boots, t_ns + RETRY_NS
        device.record["in_faults"] |= _BIT
        device.record["next_ns"] = min(int(device.record["next_ns"]), t_ns)
        if is_new:
            self.failure = why
            safe = f"; NOT SAFE: {failure}" if failure else "; the outputs are safe"
            self.report(f"{why}{safe}; they stay so until the node is reset")

    def _wait(self, t_ns: int) -> None:
        if t_ns >= self._retry_ns:
            self._retry_ns = t_ns + RETRY_NS
            self._make_safe()

    def _recovered(self, device: Device, t_ns: int) -> None:
        self.failure = ""
        device.record["in_faults"] &= ~_BIT
        device.record["next_ns"] = min(int(device.record["next_ns"]), t_ns)
        self.report("after the reset all converters answer again")

    def _make_safe(self) -> str:
        """Write every safe value, also after failures; return the first failure."""
        failure = ""
        for end in self._outputs:
            try:
                end.channel.write(end.safe_raw)
            except Exception as error:
                failure = failure or str(error)
        return failure

    # the start

    def _find(self) -> None:
        plan = self.plan
        if plan.file.python is not None:
            self._board = Board(plan.file.python.board, plan.folder)
        claimed: set[str] = set()
        for line in plan.outputs:
            channel, path = self._output(line)
            end = _End(line, channel)
            settings = line.channel
            end.safe_raw = end.raw(getattr(settings, "safe", 0.0))
            if path not in claimed:
                end.claim = Claim(path)
                claimed.add(path)
            elif not isinstance(channel, BoardOutput):
                raise HardwareError(f"{line.where}: {path} is an output already")
            self._outputs.append(end)
        self._find_buffers()
        self._inputs = [(line, self._input(line)) for line in plan.inputs]

    def _find_buffers(self) -> None:
        """Prepare a buffer for each device whose channels request it; report devices without one."""
        names: dict[str, list[str]] = {}
        for settings in (line.channel for line in self.plan.inputs):
            if isinstance(settings, IioInput) and settings.buffered:
                names.setdefault(str(find(channels.IIO, settings.device)), []).append(settings.channel)
        for folder, inputs in names.items():
            stale_ns = round(self.plan.file.loop.watchdog_s * 1e9)
            try:
                self._buffers[folder] = IioBuffer(Path(folder), dict.fromkeys(inputs), stale_ns)
            except NoBuffer as error:
                self.report(f"{error}; its channels are read one by one")

    def _output(self, line: Line) -> tuple[Output, str]:
        """Return the channel of a line, and the file to claim."""
        settings = line.channel
        if isinstance(settings, IioOutput):
            file = iio(settings.device, settings.channel, scaled=settings.scaled)
            return file, file.path
        if isinstance(settings, PwmChannel):
            pwm = PwmOutput(settings.device, settings.channel, round(settings.pwm_period_s * 1e9))
            return pwm, pwm.path
        assert self._board is not None
        return BoardOutput(self._board, str(settings.channel)), self._board.path

    def _input(self, line: Line) -> Input:
        settings = line.channel
        if isinstance(settings, IioInput):
            file = iio(settings.device, settings.channel, scaled=settings.scaled)
            buffer = self._buffers.get(str(find(channels.IIO, settings.device))) if settings.buffered else None
            return file if buffer is None else BufferedInput(buffer, settings.channel, file.scale, file.offset)
        if isinstance(settings, CounterInput):
            return counter(settings.device, settings.channel)
        assert self._board is not None
        return BoardInput(self._board, str(settings.channel))

    def _begin(self) -> None:
        """Write the safe values and read them back; read every input."""
        for end in self._outputs:
            if isinstance(end.channel, PwmOutput):
                end.channel.set_up(end.safe_raw)
            end.channel.write(end.safe_raw)
            got, expected = finite(end.channel.read_back(), end.line.where), end.channel.spelled(end.safe_raw)
            if not math.isclose(got, expected, rel_tol=1e-6, abs_tol=1e-9):
                raise HardwareError(f"{end.line.where}: the safe value {expected:g} was written, {got:g} is read back")
        if self._board is not None:
            self._board.refresh()
        for buffer in self._buffers.values():
            buffer.open(self.plan.file.loop.watchdog_s / 2)
        for line, channel in self._inputs:
            self._value(line, channel)


def _set_object(device: Device, line: Line, value: float) -> bool:
    """Set an object that no kind uses; tell whether it has changed."""
    kind = DATA_TYPES.get(device.description.variable(*line.key).data_type)
    number = value if kind is not None and kind.kind == "real" else round(value)
    whole = device.description.variable(*line.key).whole
    if whole is not None:
        number = min(max(number, whole[0]), whole[1])
    if device.dictionary[line.key] == number:
        return False
    device.dictionary[line.key] = number
    return True
