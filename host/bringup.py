"""Bring-up over SDO: know the devices, configure them, read everything back, start them. Then, and only then, the cycle may begin.

Nothing is assumed of a drive's defaults: PDOs are always mapped anew, inhibit times set to 0, limits written and read back. Every
difference is collected and told at once; with any of them the host refuses to go on.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from eds.cia301 import NmtState, abort_text
from eds.cia402 import OPERATION_MODE_CST, STATE_OF_STATUSWORD, PowerState
from eds.reader import Description, Value
from eds.rig import Rig
from eds.rig_model import Brake, Motor
from eds.signals import RigPdo
from host.controller import Controller
from host.controllers import Controllers
from host.errors import DeviceMismatch, NodeMissing, SdoAborted
from host.records import Image
from wire.plan_rig import plans

__all__ = ["ControlPlane", "bring_up", "check_plan", "release", "shut_down"]

INVALID = 1 << 31
SETTLE_NS = 50_000_000
LATE_HEARTBEATS = 5
"""So many more are waited for after NMT start before a node counts as missing."""


class ControlPlane(Protocol):
    """The slow side of a bus: a `canopen` network, and time that passes while one waits."""

    network: canopen.Network

    def wait_ns(self, duration_ns: int) -> None:
        """Let `duration_ns` pass while frames are received."""

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state that the node's last heartbeat told, None when it was never heard."""


@dataclass(frozen=True)
class Setting:
    """One object to write and read back."""

    index: int
    subindex: int
    value: int
    optional: bool = False
    """True: a device without the object is accepted."""


class _Device:
    """SDO access to one node, with sizes from its EDS and errors in words."""

    def __init__(
        self, plane: ControlPlane, name: str, node_id: int, description: Description, timeout_s: float
    ) -> None:
        self.name, self.node_id, self.description = name, node_id, description
        self.node = canopen.RemoteNode(node_id, canopen.ObjectDictionary())
        plane.network.add_node(self.node)
        self.node.sdo.RESPONSE_TIMEOUT = timeout_s

    def _where(self, index: int, subindex: int) -> str:
        try:
            label = f" {self.description.variable(index, subindex).name}"
        except KeyError:
            label = ""
        return f"{self.name} (node {self.node_id}), object {index:04X}h:{subindex:02X}{label}"

    def _guard(self, index: int, subindex: int, error: Exception) -> Exception:
        if isinstance(error, SdoAbortedError):
            return SdoAborted(f"{self._where(index, subindex)}: abort {error.code:08X}h, {abort_text(error.code)}")
        return NodeMissing(
            f"{self.name} (node {self.node_id}) does not answer SDO: check power, cable, bit rate and node id"
        )

    def read(self, index: int, subindex: int) -> int:
        """Return the object's value; numbers are signed as the EDS says."""
        try:
            data = self.node.sdo.upload(index, subindex)
        except (SdoAbortedError, SdoCommunicationError) as error:
            raise self._guard(index, subindex, error) from None
        return int.from_bytes(data, "little")

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write the object in the size that the EDS declares."""
        size = (self.description.variable(index, subindex).bits + 7) // 8
        try:
            self.node.sdo.download(index, subindex, (value & ((1 << 8 * size) - 1)).to_bytes(size, "little"))
        except (SdoAbortedError, SdoCommunicationError) as error:
            raise self._guard(index, subindex, error) from None

    def configure(self, settings: Iterator[Setting]) -> list[str]:
        """Write every setting in its order, then read all of them back; return the differences in words."""
        written = {}
        for setting in settings:
            if not self.description.has(setting.index, setting.subindex):
                if not setting.optional:
                    raise DeviceMismatch(
                        f"{self._where(setting.index, setting.subindex)} is needed, but {self.description.path} does not have it"
                    )
                continue
            self.write(setting.index, setting.subindex, setting.value)
            written[setting.index, setting.subindex] = setting.value  # the last value of an object counts
        differences = []
        for (index, subindex), value in written.items():
            bits = self.description.variable(index, subindex).bits
            there = self.read(index, subindex)
            if there != value & ((1 << bits) - 1):
                differences.append(f"{self._where(index, subindex)}: wrote {value:#x}, reads back {there:#x}")
        return differences


def _pdo_settings(pdo: RigPdo, deadline_ms: int) -> Iterator[Setting]:
    """The prescribed procedure: invalid, no entries, parameters, entries, their number, valid (CiA 301, 7.5.2.36)."""
    layout = pdo.layout
    receive = layout.direction == "rpdo"
    communication = (0x1400 if receive else 0x1800) + layout.number - 1
    mapping = communication + 0x200
    yield Setting(communication, 1, layout.cob_id | INVALID)
    yield Setting(mapping, 0, 0)
    yield Setting(communication, 2, layout.transmission)
    if receive:
        yield Setting(communication, 5, deadline_ms)
    else:
        yield Setting(communication, 3, 0, optional=True)
        yield Setting(communication, 5, 0, optional=True)
        yield Setting(communication, 6, 0, optional=True)
    for i, entry in enumerate(layout.entries, start=1):
        yield Setting(mapping, i, entry.index << 16 | entry.subindex << 8 | entry.bits)
    yield Setting(mapping, 0, len(layout.entries))
    yield Setting(communication, 1, layout.cob_id)


def _unused_pdos(description: Description, pdos: tuple[RigPdo, ...]) -> Iterator[Setting]:
    """Switch every PDO off that the rig does not use: a default PDO would load the bus unplanned."""
    used = {(pdo.layout.direction, pdo.layout.number) for pdo in pdos}
    for base, direction in ((0x1400, "rpdo"), (0x1800, "tpdo")):
        for number in range(1, 513):
            index = base + number - 1
            if description.has(index, 1) and (direction, number) not in used:
                default = description.default(index, 1, 0)
                if isinstance(default, int) and not default & INVALID:
                    yield Setting(index, 1, default | INVALID)


def _common_settings(rig: Rig, part: Motor | Brake) -> Iterator[Setting]:
    """Heartbeats both ways and the loss of SYNC."""
    timeout_ms = round(part.heartbeat_timeout_s * 1000)
    yield Setting(0x1016, 1, rig.host.node_id << 16 | timeout_ms)
    yield Setting(0x1017, 0, round(part.heartbeat_s * 1000))
    yield Setting(0x1005, 0, 0x80)
    yield Setting(0x2002, 0, round(part.sync_timeout_s * 1e6), optional=True)


def _motor_settings(rig: Rig, limit_pm: int) -> Iterator[Setting]:
    yield Setting(0x6060, 0, OPERATION_MODE_CST)
    yield Setting(0x6071, 0, 0)
    yield Setting(0x6072, 0, limit_pm)
    yield Setting(0x2001, 0, round(rig.motor.setpoint_zero_cycles * rig.bus.period_s * 1e6), optional=True)


def _brake_settings(rig: Rig) -> Iterator[Setting]:
    yield Setting(0x6340, 1, 1)
    yield Setting(0x7341, 1, 0)
    yield Setting(0x2001, 0, round(rig.brake.hold_s * 1e6), optional=True)
    yield Setting(0x2005, 0, round(rig.brake.ramp_s * 1e6), optional=True)


def _identity(device: _Device, part: Motor | Brake) -> list[str]:
    """Compare device type (1000) and identity (1018) with the EDS and the rig file."""
    expected: dict[tuple[int, int], tuple[str, Value]] = {
        (0x1000, 0): ("device type", device.description.default(0x1000, 0, device.node_id)),
        (0x1018, 1): ("vendor id", part.vendor_id),
        (0x1018, 2): ("product code", part.product_code),
    }
    differences = []
    for (index, subindex), (what, value) in expected.items():
        there = device.read(index, subindex)
        if isinstance(value, int) and there != value:
            differences.append(
                f"{device.name} (node {device.node_id}): {what} {index:04X}h:{subindex:02X} is {there:#010x}, the rig file says {value:#010x}"
            )
    return differences


def check_plan(rig: Rig) -> None:
    """Refuse a rig whose messages do not fit on their bus in the worst case.

    Raises
    ------
    DeviceMismatch
        Naming each late frame.
    """
    for planned in plans(rig).values():
        if not planned.fits:
            raise DeviceMismatch(planned.verdict())


def bring_up(controllers: Controllers, plane: ControlPlane) -> None:
    """Make all nodes ready for the cycle: identified, configured, read back, OPERATIONAL.

    Parameters
    ----------
    controllers : whose rig it is; the drives' own torque limits 6072h are theirs
    plane : the control plane's network; the nodes are on the bus and powered

    Raises
    ------
    NodeMissing, SdoAborted, DeviceMismatch
        nothing was armed; the nodes are left in PRE-OPERATIONAL
    """
    check_plan(controllers.rig)
    nmt = plane.network.nmt
    nmt.send_command(0x80)  # enter PRE-OPERATIONAL
    plane.wait_ns(SETTLE_NS)
    axes = [_Axis(controller, plane) for controller in controllers]
    differences = [text for axis in axes for text in axis.identity()]
    if differences:
        raise DeviceMismatch("; ".join(differences))
    for axis in axes:
        axis.check_modes()
    differences = [text for axis in axes for text in axis.configure()]
    if differences:
        raise DeviceMismatch("; ".join(differences))
    nmt.send_command(0x01)  # start
    devices = [pair for axis in axes for pair in axis.devices]
    heartbeat_ns = round(1e9 * max(part.heartbeat_s for _, part in devices))
    plane.wait_ns(SETTLE_NS + 2 * heartbeat_ns)
    for _ in range(LATE_HEARTBEATS):
        if all(plane.nmt_state(device.node_id) == NmtState.OPERATIONAL for device, _ in devices):
            return
        plane.wait_ns(heartbeat_ns)
    for device, _ in devices:
        state = plane.nmt_state(device.node_id)
        if state != NmtState.OPERATIONAL:
            heard = "was not heard" if state is None else f"says {NmtState(state).name}"
            raise NodeMissing(f"{device.name} (node {device.node_id}) {heard} after NMT start; OPERATIONAL is expected")


class _Axis:
    """Drive and brake of one axis, and what each is to be set to."""

    def __init__(self, controller: Controller, plane: ControlPlane) -> None:
        rig = controller.rig
        self._rig, self._limit_pm = rig, int(controller.control["motor_limit_pm"][0])
        timeout_s = rig.host.sdo_timeout_s
        motor = _Device(plane, f"{rig.prefix}motor", rig.motor.node_id, rig.description("motor"), timeout_s)
        brake = _Device(plane, f"{rig.prefix}brake", rig.brake.node_id, rig.description("brake"), timeout_s)
        self._motor = motor
        self.devices: tuple[tuple[_Device, Motor | Brake], ...] = ((motor, rig.motor), (brake, rig.brake))

    def identity(self) -> list[str]:
        return [text for device, part in self.devices for text in _identity(device, part)]

    def check_modes(self) -> None:
        device = self._motor
        modes = device.read(0x6502, 0) if device.description.has(0x6502) else 1 << (OPERATION_MODE_CST - 1)
        if not modes >> (OPERATION_MODE_CST - 1) & 1:
            raise DeviceMismatch(
                f"{device.name}: supported drive modes 6502h = {modes:#010x} do not include cyclic synchronous torque"
            )

    def configure(self) -> list[str]:
        return [text for device, part in self.devices for text in device.configure(self._settings(device, part))]

    def _settings(self, device: _Device, part: Motor | Brake) -> Iterator[Setting]:
        pdos = tuple(pdo for pdo in self._rig.pdos() if pdo.node == device.name)
        yield from _unused_pdos(device.description, pdos)
        yield from _common_settings(self._rig, part)
        yield from _motor_settings(self._rig, self._limit_pm) if device is self._motor else _brake_settings(self._rig)
        for pdo in pdos:
            yield from _pdo_settings(pdo, round(part.setpoint_fault_s * 1000))


def release(controllers: Controllers, plane: ControlPlane) -> None:
    """Put the nodes into PRE-OPERATIONAL and, at a normal end, take the watch over this host off them (1016h:01 = 0).

    Else each of them would tell of a lost heartbeat (EMCY 8130h) as soon as this host has gone. After a trip, or where a drive is not known to be
    disabled, the watch stays. To be called before the host's heartbeat is missed.
    """
    plane.network.nmt.send_command(0x80)
    drives = [STATE_OF_STATUSWORD[int(k.host["image"][0, Image.STATUSWORD]) & 0x7F] for k in controllers]
    disabled = all(drive == PowerState.SWITCH_ON_DISABLED for drive in drives)
    if not (controllers.done and controllers.trip is None and disabled):
        return
    for controller in controllers:
        for part in (controller.rig.motor, controller.rig.brake):
            with suppress(SdoAbortedError, SdoCommunicationError):  # then it says so: nothing is lost by that
                plane.network[part.node_id].sdo.download(0x1016, 1, bytes(4))


def shut_down(plane: ControlPlane) -> None:
    """Leave the nodes in PRE-OPERATIONAL, where no PDO acts; only the heartbeat is still watched there."""
    plane.network.nmt.send_command(0x80)
    plane.wait_ns(SETTLE_NS)
