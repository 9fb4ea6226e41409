"""Bring-up over SDO: identify the devices, configure them, read everything back, start them.

The cycle begins only after a complete bring-up.

`host.setup.device_plan` has the objects to write and to read back, from EDS and rig file. All problems of
the plan are reported together, before the first frame is sent. All differences of the devices are
collected and reported together, too. Any problem or difference is a refusal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Protocol
from weakref import WeakKeyDictionary

from coulombus.eds.cia301 import CobId, NmtCommand, NmtState, abort_text
from coulombus.eds.cia402 import STATE_OF_STATUSWORD, PowerState
from coulombus.eds.data import without_fill
from coulombus.eds.drive_axis import of_axis
from coulombus.eds.own_devices import MANUFACTURER, is_own
from coulombus.eds.reader import Value, Variable
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image
from coulombus.host.errors import AnswerUntrusted, DeviceMismatch, HostError, NodeMissing, SdoAborted
from coulombus.host.sdo.sdo_client import BusAnswers, SdoClient
from coulombus.host.sdo.transfers import DuplicateNodeId, SdoProtocolError, SdoRefused, SdoSilent
from coulombus.host.setup.device_plan import SUPPORTED_MODES, DevicePlan, device_plans, missing_mode
from coulombus.host.setup.law_demand import check_demand
from coulombus.host.setup.mode_display import check_shown_mode, mode_remedy, mode_words
from coulombus.host.setup.position_scale import scale_differences
from coulombus.host.setup.settings import Setting, encoded, number_of
from coulombus.rigs.device_services import beats, is_guarded
from coulombus.rigs.devices import drive_axis_of
from coulombus.rigs.plan.rig_plan import plans
from coulombus.rigs.rig import Rig
from coulombus.wire.bus_link import FrameLink

__all__ = [
    "ControlPlane",
    "bring_up",
    "check_plan",
    "configure",
    "meet",
    "plans_of",
    "release",
    "shut_down",
    "wait_operational",
]

SETTLE_NS = 50_000_000
LATE_HEARTBEATS = 5
"""Number of further heartbeat periods after NMT start before a node counts as missing."""


class ControlPlane(FrameLink, Protocol):
    """The control plane of a bus: a link for SDO and NMT, heartbeats, and waiting."""

    sdo_timeout_s: float
    """Time-out of an SDO response: the rig file's host.sdo_timeout_s."""

    def wait_ns(self, duration_ns: int) -> None:
        """Wait for `duration_ns` while frames are received."""

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state in the node's last heartbeat; None before the first."""


class _DeviceAccess:
    """SDO access to one node, with sizes from its EDS and readable errors.

    Parameters
    ----------
    answers : SDO answers of all nodes of this bring-up
    """

    def __init__(self, plane: ControlPlane, plan: DevicePlan, answers: BusAnswers) -> None:
        self.plan, self.description = plan, plan.description
        self.name, self.node_id = plan.name, plan.node_id
        self.client = SdoClient(plane, self.node_id, plane.sdo_timeout_s, answers=answers)
        self.identity = (0, 0)
        self.losses: list[str] = []

    def _where(self, index: int, subindex: int) -> str:
        try:
            label = f" {self.description.variable(index, subindex).name}"
        except KeyError:
            label = ""
        return f"{self.name} (node {self.node_id}), object {index:04X}h:{subindex:02X}{label}"

    @contextmanager
    def _named(self, index: int, subindex: int) -> Iterator[None]:
        """Add the device and the object to the text of an error."""
        try:
            yield
        except SdoRefused as error:
            text = f"{self._where(index, subindex)}: abort {error.code:08X}h, {abort_text(error.code)}"
            raise SdoAborted(text) from None
        except SdoSilent:
            raise NodeMissing(
                f"{self.name} (node {self.node_id}) does not answer SDO: check power, cable, bit rate and node id"
            ) from None
        except DuplicateNodeId:
            raise
        except SdoProtocolError as error:
            raise AnswerUntrusted(
                f"{self._where(index, subindex)}: {error.reason}: does another SDO client ask it now, "
                "or have two devices this node id?"
            ) from None

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the object as the device sends it."""
        variable = self._variable(index, subindex)
        with self._named(index, subindex):
            return self.client.upload(
                index, subindex, unsized=lambda data: data if variable is None else without_fill(variable, data)
            )

    def _variable(self, index: int, subindex: int) -> Variable | None:
        return self.description.variable(index, subindex) if self.description.has(index, subindex) else None

    def number(self, index: int, subindex: int) -> int:
        """Return an UNSIGNED32 object, such as 1000h, 1018h and 6502h.

        Raises
        ------
        DeviceMismatch
            the object has another length
        """
        data = self.upload(index, subindex)
        if len(data) != 4:
            raise DeviceMismatch(
                f"{self._where(index, subindex)} has {len(data)} bytes in the device; expected 4, an UNSIGNED32"
            )
        return int.from_bytes(data, "little")

    def write(self, setting: Setting) -> None:
        """Write the object in the size that the EDS declares.

        A manufacturer-specific object is written only if the device is this project's, or the rig file
        lists the object.

        Raises
        ------
        DeviceMismatch, OverflowError
            a third-party device, or a value that does not fit; nothing was sent
        """
        index, subindex = setting.index, setting.subindex
        if index in MANUFACTURER and not (setting.listed or is_own(self.plan.role, self.identity)):
            vendor, product = self.identity
            raise DeviceMismatch(
                f"{self._where(index, subindex)} is the maker's own object, and the device is not ours "
                f"(1018h: vendor {vendor:#010x}, product {product:#010x}); take the EDS file of this very device"
            )
        data = encoded(setting.variable(self.description), setting.value)
        if setting.unless_equal and self.upload(index, subindex) == data:
            return
        with self._named(index, subindex):
            self.client.download(index, subindex, data)

    def identify(self) -> list[str]:
        """Read device type (1000h) and identity (1018h); return their differences from EDS and rig file."""
        expected: dict[tuple[int, int], tuple[str, str, Value]] = {
            (0x1000, 0): ("device type", "the EDS file", self.description.default(0x1000, 0, self.node_id)),
            **{(0x1018, sub): (what, "the rig file", value) for sub, what, value in self.plan.identity},
        }
        differences, device_values = [], {}
        for (index, subindex), (what, source, value) in expected.items():
            device_values[index, subindex] = self.number(index, subindex)
            if isinstance(value, int) and device_values[index, subindex] != value:
                differences.append(
                    f"{self.name} (node {self.node_id}): {what} {index:04X}h:{subindex:02X} is {device_values[index, subindex]:#010x}, "
                    f"{source} says {value:#010x}"
                )
        self.identity = device_values.get((0x1018, 1), 0), device_values.get((0x1018, 2), 0)
        return differences

    def check_modes(self) -> None:
        """Refuse a drive whose supported drive modes 6502h lack the required mode."""
        index = of_axis(SUPPORTED_MODES, drive_axis_of(self.plan.part))
        if self.plan.mode is None or not self.description.has(index):
            return
        modes = self.number(index, 0)
        if lacking := missing_mode(modes, self.plan.mode):
            raise DeviceMismatch(
                f"{self.name}: supported drive modes {index:04X}h = {modes:#010x} do not include {lacking}"
            )

    def scale_differences(self) -> Iterator[str]:
        """Yield the differences of the drive's own scale from the rig file's (`setup.position_scale`)."""
        return scale_differences(self.plan.position, self.description.has, self.upload)

    def configure(self) -> list[str]:
        """Write every setting in its order, then read all of them back; return the texts of differences.

        A refused setting that the host can do without is a loss.
        """
        left_out = set()
        for setting in self.plan.writes:
            try:
                self.write(setting)
            except SdoAborted as refused:
                if not setting.soft and setting.key == f"{self.plan.role}.mode":
                    mode = mode_words(setting.value)
                    raise SdoAborted(
                        f"{refused}: it refuses mode {mode}; {mode_remedy(self.plan, self.upload)}"
                    ) from None
                if not setting.soft:
                    raise
                left_out.add((setting.index, setting.subindex))
                self.losses.append(f"{refused}; {setting.lost or setting.why}")
        differences = []
        variables = {(s.index, s.subindex): s.variable(self.description) for s in self.plan.writes}
        for (index, subindex), value in self.plan.read_backs:
            if (index, subindex) in left_out:
                continue
            variable = variables.get((index, subindex)) or self.description.variable(index, subindex)
            data, stored = encoded(variable, value), self.upload(index, subindex)
            if len(stored) != len(data):
                differences.append(
                    f"{self._where(index, subindex)} has {len(stored)} bytes in the device, {len(data)} in {self.description.path}"
                )
            elif stored != data:
                number = number_of(variable, stored)
                differences.append(f"{self._where(index, subindex)}: wrote {value:#x}, reads back {number:#x}")
        return differences


def check_plan(rig: Rig) -> None:
    """Refuse a rig whose messages do not fit on their bus in the worst case.

    Raises
    ------
    DeviceMismatch
        the text names each late frame
    """
    for planned in plans(rig).values():
        if not planned.fits:
            raise DeviceMismatch(planned.verdict())


def plans_of(controllers: Controllers) -> tuple[DevicePlan, ...]:
    """Return the bring-up plans of all devices, axis by axis: drive, brake, sensors."""
    if controllers not in _plans:
        _plans[controllers] = tuple(plan for controller in controllers for plan in device_plans(controller))
    return _plans[controllers]


_plans: WeakKeyDictionary[Controllers, tuple[DevicePlan, ...]] = WeakKeyDictionary()
"""Cache of the plans, which are needed at the beginning and at the end of a run."""


def meet(plans: Sequence[DevicePlan], controllers: Controllers) -> None:
    """Store the plans of devices that are already set up, as after `bring_up`."""
    _plans[controllers] = tuple(plans)


def bring_up(controllers: Controllers, plane: ControlPlane) -> tuple[str, ...]:
    """Make all nodes ready for the cycle: identified, configured, read back, OPERATIONAL.

    Parameters
    ----------
    controllers : controllers of the rig; they set the drives' torque limits 6072h
    plane : the control plane; the nodes are on the bus and powered

    Returns
    -------
    tuple of str
        The settings that were not written, because a device lacks the object or is third-party, each
        with the protection that the host loses.

    Raises
    ------
    NodeMissing, SdoAborted, AnswerUntrusted, DeviceMismatch
        nothing was armed; the nodes are left in PRE-OPERATIONAL, or nothing was sent if EDS and rig file
        do not match
    coulombus.rigs.rig.RigError
        a limit would clip the law; nothing was sent
    """
    check_plan(controllers.rig)
    check_demand(controllers.rig, controllers.mode)
    plans = plans_of(controllers)
    losses = configure(plans, plane)
    _command(plane, NmtCommand.START)
    wait_operational(plans, plane)
    return (*losses, *_shown_modes(plans, plane))


def _shown_modes(plans: Sequence[DevicePlan], plane: ControlPlane) -> tuple[str, ...]:
    """Compare the modes that the drives display with the written modes; return the losses."""
    devices = [_DeviceAccess(plane, plan, BusAnswers()) for plan in plans]
    try:
        losses = [check_shown_mode(device.plan, device.upload, plane.wait_ns) for device in devices]
    except HostError:
        _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
        plane.wait_ns(SETTLE_NS)
        raise
    return tuple(filter(None, losses))


def configure(plans: Sequence[DevicePlan], plane: ControlPlane) -> tuple[str, ...]:
    """Write the settings of the plans to the devices, and read them back.

    The devices are left in PRE-OPERATIONAL. Returns and raises as `bring_up`, but does not check whether
    the cycle fits on the bus.
    """
    _refuse(str(problem) for plan in plans for problem in plan.problems)
    _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
    plane.wait_ns(SETTLE_NS)
    answers = BusAnswers()
    devices = [_DeviceAccess(plane, plan, answers) for plan in plans]
    try:
        _refuse([text for device in devices for text in device.identify()])
        for device in devices:
            device.check_modes()
        _refuse([text for device in devices for text in (*device.configure(), *device.scale_differences())])
    except HostError:  # a second device with the same node id may still answer, which would explain the error
        answers.listen(plane, plane.now_ns() + SETTLE_NS)
        _refuse_duplicates(devices, answers)
        raise
    answers.listen(plane, plane.now_ns())
    _refuse_duplicates(devices, answers)
    return tuple(text for device in devices for text in (*device.plan.losses, *device.losses))


def _command(plane: ControlPlane, command: NmtCommand) -> None:
    """Send an NMT command to all nodes."""
    plane.send(CobId.NMT, bytes((command, 0)))


def _refuse_duplicates(devices: Sequence[_DeviceAccess], answers: BusAnswers) -> None:
    node_ids = answers.duplicate_node_ids
    _refuse(
        f"two devices answer as node {device.node_id} ({device.name}): take one off the bus, and give the other "
        "another id (coulombus lss)"
        for device in devices
        if device.node_id in node_ids
    )


def wait_operational(plans: Sequence[DevicePlan], plane: ControlPlane) -> None:
    """Wait until the heartbeats of these devices report OPERATIONAL after NMT start.

    Raises
    ------
    NodeMissing
        a device reports another state, or sends no heartbeat
    """
    heartbeat_ns = round(1e9 * max(plan.part.heartbeat_s for plan in plans))
    plane.wait_ns(SETTLE_NS + 2 * heartbeat_ns)
    heard = [plan for plan in plans if beats(plan.description) and not is_guarded(plan.description)]
    for _ in range(LATE_HEARTBEATS):
        if all(plane.nmt_state(plan.node_id) == NmtState.OPERATIONAL for plan in heard):
            break
        plane.wait_ns(heartbeat_ns)
    for plan in heard:
        state = plane.nmt_state(plan.node_id)
        if state != NmtState.OPERATIONAL:
            state_text = "was not heard" if state is None else f"says {NmtState(state).name}"
            raise NodeMissing(
                f"{plan.name} (node {plan.node_id}) {state_text} after NMT start; OPERATIONAL is expected"
            )


def _refuse(differences: Iterable[str]) -> None:
    """Raise DeviceMismatch with all differences, if there are any."""
    text = "; ".join(differences)
    if text:
        raise DeviceMismatch(text)


def release(controllers: Controllers, plane: ControlPlane) -> None:
    """Put the nodes into PRE-OPERATIONAL; at a normal end also disable their heartbeat consumer for this
    host (1016h:01 = 0).

    Otherwise each node would send an EMCY for the lost heartbeat (8130h) after this host's end. After a
    trip, or while a drive may still be enabled, the consumer stays active. Call it before the nodes miss
    the host's heartbeat.
    """
    _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
    drives = [STATE_OF_STATUSWORD[int(k.host["image"][0, Image.STATUSWORD]) & 0x7F] for k in controllers]
    disabled = all(drive == PowerState.SWITCH_ON_DISABLED for drive in drives)
    if not (controllers.done and controllers.trip is None and disabled):
        return
    for plan in plans_of(controllers):
        watch = next((write for write in plan.writes if (write.index, write.subindex) == (0x1016, 1)), None)
        if watch is None:
            continue
        data = encoded(watch.variable(plan.description), 0)
        with suppress(HostError):  # then the node sends the EMCY, which is harmless
            SdoClient(plane, plan.node_id, plane.sdo_timeout_s).download(0x1016, 1, data)


def shut_down(plane: ControlPlane) -> None:
    """Leave the nodes in PRE-OPERATIONAL, where PDOs have no effect.

    In this state the nodes monitor only the heartbeat.
    """
    _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
    plane.wait_ns(SETTLE_NS)
