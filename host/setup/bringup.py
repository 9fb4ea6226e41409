"""Bring-up over SDO: know the devices, configure them, read everything back, start them.

Then, and only then, the cycle may begin.

What is written and read back stands in `host.setup.device_plan`, made from EDS and rig file. What
is wrong with it is told before anything is sent, all of it at once; every difference of the devices
is collected and told at once, too. With any of them the host refuses to go on.
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
from coulombus.host.sdo.bus_answers import BusAnswers
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.host.sdo.transfers import DuplicateNodeId, SdoProtocolError, SdoRefused, SdoSilent
from coulombus.host.setup.device_plan import SUPPORTED_MODES, DevicePlan, device_plans, missing_mode
from coulombus.host.setup.law_demand import check_demand
from coulombus.host.setup.mode_display import check_shown_mode, mode_remedy, mode_words
from coulombus.host.setup.position_scale import scale_differences
from coulombus.host.setup.settings import Setting, encoded, number_of
from coulombus.rigs.devices import drive_axis_of
from coulombus.rigs.guarding import beats, is_guarded
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
"""So many more are waited for after NMT start before a node counts as missing."""


class ControlPlane(FrameLink, Protocol):
    """The slow side of a bus: a link, heartbeats, and time that passes while one waits."""

    sdo_timeout_s: float
    """How long an SDO response is waited for: the rig file's host.sdo_timeout_s."""

    def wait_ns(self, duration_ns: int) -> None:
        """Let `duration_ns` pass while frames are received."""

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state that the node's last heartbeat told, None when it was never
        heard.
        """


class _Device:
    """SDO access to one node, with sizes from its EDS and errors in words.

    Parameters
    ----------
    answers : of all nodes that are brought up
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
        """Say of an error which device and object it is about."""
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
        """Return an unsigned object of 32 bits, as 1000h, 1018h and 6502h are.

        Raises
        ------
        DeviceMismatch
            it has another length
        """
        data = self.upload(index, subindex)
        if len(data) != 4:
            raise DeviceMismatch(
                f"{self._where(index, subindex)} has {len(data)} bytes in the device; expected 4, an UNSIGNED32"
            )
        return int.from_bytes(data, "little")

    def write(self, setting: Setting) -> None:
        """Write the object in the size that the EDS declares; a maker's own only where the maker is
        this project, or the rig file lists it.

        Raises
        ------
        DeviceMismatch, OverflowError
            a device of another maker, a value that does not fit: nothing was sent
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
        """Read device type (1000h) and identity (1018h).

        Return how they differ from the EDS and the rig file.
        """
        expected: dict[tuple[int, int], tuple[str, str, Value]] = {
            (0x1000, 0): ("device type", "the EDS file", self.description.default(0x1000, 0, self.node_id)),
            **{(0x1018, sub): (what, "the rig file", value) for sub, what, value in self.plan.identity},
        }
        differences, there = [], {}
        for (index, subindex), (what, source, value) in expected.items():
            there[index, subindex] = self.number(index, subindex)
            if isinstance(value, int) and there[index, subindex] != value:
                differences.append(
                    f"{self.name} (node {self.node_id}): {what} {index:04X}h:{subindex:02X} is {there[index, subindex]:#010x}, "
                    f"{source} says {value:#010x}"
                )
        self.identity = there.get((0x1018, 1), 0), there.get((0x1018, 2), 0)
        return differences

    def check_modes(self) -> None:
        """Refuse a drive whose supported drive modes 6502h lack the one that is needed."""
        index = of_axis(SUPPORTED_MODES, drive_axis_of(self.plan.part))
        if self.plan.mode is None or not self.description.has(index):
            return
        modes = self.number(index, 0)
        if lacking := missing_mode(modes, self.plan.mode):
            raise DeviceMismatch(
                f"{self.name}: supported drive modes {index:04X}h = {modes:#010x} do not include {lacking}"
            )

    def scale_differences(self) -> Iterator[str]:
        """Yield how the drive's own scale differs from the rig file's (`setup.position_scale`)."""
        return scale_differences(self.plan.position, self.description.has, self.upload)

    def configure(self) -> list[str]:
        """Write every setting in its order, then read all of them back, whole.

        Return the differences in words.

        What the host can do without, and the device refuses, is a loss.
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
            data, there = encoded(variable, value), self.upload(index, subindex)
            if len(there) != len(data):
                differences.append(
                    f"{self._where(index, subindex)} has {len(there)} bytes in the device, {len(data)} in {self.description.path}"
                )
            elif there != data:
                number = number_of(variable, there)
                differences.append(f"{self._where(index, subindex)}: wrote {value:#x}, reads back {number:#x}")
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


def plans_of(controllers: Controllers) -> tuple[DevicePlan, ...]:
    """Return what bring-up does to each device of all axes: drive, brake and sensors of the first,
    of the second ...
    """
    if controllers not in _plans:
        _plans[controllers] = tuple(plan for controller in controllers for plan in device_plans(controller))
    return _plans[controllers]


_plans: WeakKeyDictionary[Controllers, tuple[DevicePlan, ...]] = WeakKeyDictionary()
"""They are asked for at the beginning and at the end of a run."""


def meet(plans: Sequence[DevicePlan], controllers: Controllers) -> None:
    """Know the devices of these plans, which are set up already, as after `bring_up`."""
    _plans[controllers] = tuple(plans)


def bring_up(controllers: Controllers, plane: ControlPlane) -> tuple[str, ...]:
    """Make all nodes ready for the cycle: identified, configured, read back, OPERATIONAL.

    Parameters
    ----------
    controllers : whose rig it is; the drives' own torque limits 6072h are theirs
    plane : the control plane; the nodes are on the bus and powered

    Returns
    -------
    tuple of str
        What was not written, as a device has no such object or is not ours, and what the host loses
        by that.

    Raises
    ------
    NodeMissing, SdoAborted, AnswerUntrusted, DeviceMismatch
        nothing was armed; the nodes are left in PRE-OPERATIONAL, or nothing was sent where EDS and
        rig file do not fit
    coulombus.rigs.rig.RigError
        a limit would cut the law off; the nodes were not touched
    """
    check_plan(controllers.rig)
    check_demand(controllers.rig, controllers.mode)
    plans = plans_of(controllers)
    losses = configure(plans, plane)
    _command(plane, NmtCommand.START)
    wait_operational(plans, plane)
    return (*losses, *_shown_modes(plans, plane))


def _shown_modes(plans: Sequence[DevicePlan], plane: ControlPlane) -> tuple[str, ...]:
    """Hold the modes that the drives show against those that were written; return what is lost."""
    devices = [_Device(plane, plan, BusAnswers()) for plan in plans]
    try:
        told = [check_shown_mode(device.plan, device.upload, plane.wait_ns) for device in devices]
    except HostError:
        _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
        plane.wait_ns(SETTLE_NS)
        raise
    return tuple(filter(None, told))


def configure(plans: Sequence[DevicePlan], plane: ControlPlane) -> tuple[str, ...]:
    """Write to the devices what their plans have, and read it back.

    They are left in PRE-OPERATIONAL. Returns and raises as `bring_up`; whether the cycle fits on
    the bus is not looked at.
    """
    _refuse(str(problem) for plan in plans for problem in plan.problems)
    _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
    plane.wait_ns(SETTLE_NS)
    answers = BusAnswers()
    devices = [_Device(plane, plan, answers) for plan in plans]
    try:
        _refuse([text for device in devices for text in device.identify()])
        for device in devices:
            device.check_modes()
        _refuse([text for device in devices for text in (*device.configure(), *device.scale_differences())])
    except HostError:  # a second device of one node id may answer yet, which explains the rest
        answers.listen(plane, plane.now_ns() + SETTLE_NS)
        _refuse_duplicates(devices, answers)
        raise
    answers.listen(plane, plane.now_ns())
    _refuse_duplicates(devices, answers)
    return tuple(text for device in devices for text in (*device.plan.losses, *device.losses))


def _command(plane: ControlPlane, command: NmtCommand) -> None:
    """Send an NMT command to all nodes."""
    plane.send(CobId.NMT, bytes((command, 0)))


def _refuse_duplicates(devices: Sequence[_Device], answers: BusAnswers) -> None:
    node_ids = answers.duplicate_node_ids
    _refuse(
        f"two devices answer as node {device.node_id} ({device.name}): take one off the bus, and give the other "
        "another id (coulombus lss)"
        for device in devices
        if device.node_id in node_ids
    )


def wait_operational(plans: Sequence[DevicePlan], plane: ControlPlane) -> None:
    """Wait until the heartbeats of these devices, which were told to start, say OPERATIONAL.

    Raises
    ------
    NodeMissing
        one of them says otherwise, or nothing
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
    """Raise DeviceMismatch with all differences at once, where there are any."""
    text = "; ".join(differences)
    if text:
        raise DeviceMismatch(text)


def release(controllers: Controllers, plane: ControlPlane) -> None:
    """Put the nodes into PRE-OPERATIONAL and, at a normal end, take the watch over this host off
    them (1016h:01 = 0).

    Else each of them would tell of a lost heartbeat (EMCY 8130h) as soon as this host has gone.
    After a trip, or where a drive is not known to be disabled, the watch stays. To be called before
    the host's heartbeat is missed.
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
        with suppress(HostError):  # then it says so: nothing is lost by that
            SdoClient(plane, plan.node_id, plane.sdo_timeout_s).download(0x1016, 1, data)


def shut_down(plane: ControlPlane) -> None:
    """Leave the nodes in PRE-OPERATIONAL, where no PDO acts.

    Only the heartbeat is still watched there.
    """
    _command(plane, NmtCommand.ENTER_PRE_OPERATIONAL)
    plane.wait_ns(SETTLE_NS)
