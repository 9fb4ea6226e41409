"""Draft of a rig file: the devices of a known rig are replaced, and every guess is marked.

1. Handle, hand and law are copied from the known rig.
2. Values of the devices come from their EDS files, and from the devices' answers if they were read.
3. The file is loaded. An optional role without an object or a place in a PDO is removed, with the
   reason in the file; a cycle that is too short for the bus is lengthened. Any other error is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from coulombus.eds.drive_axis import PROFILE_OBJECTS, axis_of
from coulombus.rigs.axis import Axis
from coulombus.rigs.draft.brake import describe_brake, describe_sensors
from coulombus.rigs.draft.device import DraftDevice
from coulombus.rigs.draft.draft_text import CHECK, REHEARSAL, RigText
from coulombus.rigs.draft.motor import describe_motor
from coulombus.rigs.errors import Problem, RigError
from coulombus.rigs.pdo_records import with_accepted
from coulombus.rigs.plan.rig_plan import plans
from coulombus.rigs.rig import Rig, load_rig, load_rig_text
from coulombus.rigs.roles import ROLES
from coulombus.system.foreign_text import one_line

__all__ = ["Draft"]

SIMULATED = ("plant", "operator", "phase")
OPTIONAL = {kind.name for kind in ROLES if not kind.needed and kind.unit}
RESPONSE_US = 150.0
"""Assumed time between SYNC and the TPDOs of an unmeasured device."""
PERIODS_S = (1e-3, 2e-3, 4e-3, 5e-3)
"""Cycles to try, shortest first."""
WINDOW = 0.74
"""Share of the cycle in which the host waits for the TPDOs."""
MISSED, MOST_MISSED = "limits.missed_tpdo_cycles", 10
"""Limit on the wait for a TPDO that the device sends by its own timer."""
SAME_IN_PLANT = {
    "ratio": "mechanics.ratio",
    "encoder_counts_rev": "motor.encoder_counts_rev",
    "motor_rated_torque_Nm": "motor.rated_torque_Nm",
    "motor_polarity": "mechanics.motor_polarity",
    "encoder_polarity": "mechanics.encoder_polarity",
    "transducer_polarity": "mechanics.transducer_polarity",
    "brake_max_Nm": "brake.rated_torque_Nm",
}
"""Keys of the simulated rig that equal the host's model in a rehearsal."""
OWN_RIG = "bench"
"""The packaged rig with the project's own devices."""


class Draft:
    """A rig file under construction; ``str()`` is its text.

    Parameters
    ----------
    devices : motor, brake, and any sensors
    like : the rig from which everything but the devices is copied
    path : of the new file; its EDS files are found relative to it
    rehearse : with the simulated rig, and the keys that only simulated devices need
    accept : the user's acknowledgements (``host.accept``)

    Raises
    ------
    RigError
        a device cannot have a role that the host needs; `problems` has them by role
    """

    def __init__(
        self,
        devices: Sequence[DraftDevice],
        like: Axis,
        path: str,
        *,
        rehearse: bool = False,
        accept: Sequence[str] = (),
    ) -> None:
        self.devices = tuple(
            replace(device, description=with_accepted(device.description, device.node, accept)) for device in devices
        )
        for device in self.devices:
            _check_axis(device)
        self.like, self.path, self.rehearse = like, path, rehearse
        values = like.model_dump(by_alias=True, exclude_defaults=True)
        for name in ("sensor", "role", "axis", *(() if rehearse else SIMULATED)):
            values.pop(name, None)
        values["mechanics"].pop("counts_turn", None)  # of the other rig's encoder
        for key in ("accept", "deadman"):  # of the other rig's devices
            values["host"].pop(key, None)
        node_ids = {device.node_id for device in self.devices}
        values["host"]["node_id"] = next(
            number for number in (like.host.node_id, *range(127, 0, -1)) if number not in node_ids
        )
        values["law"]["function"] = _law_from_anywhere(like)
        self.text = RigText(values)
        if accept:
            self.text.put("host.accept", list(accept), "acknowledged by the user; prove each sentence on the device")
        self._about()
        for device in self.devices:
            self._device(device)
        motor, brake, *sensors = self.devices
        if not motor.is_own:
            describe_motor(self.text, motor)
        if not brake.is_own:
            describe_brake(self.text, brake)
        describe_sensors(self.text, sensors)
        self._cycle(like.bus.period_s)
        if rehearse:
            self._truth()
        self.rig = self._settled()

    def __str__(self) -> str:
        return str(self.text)

    def acknowledge(self, sentences: Iterable[str]) -> None:
        """Add acknowledgements for a rehearsal (``host.accept``)."""
        accepted = list(dict.fromkeys((*(self.text.get("host.accept") or ()), *sentences)))
        if not accepted:
            return
        why = "the simulated devices are accepted as they are. Decide on each sentence for the real ones"
        self.text.put("host.accept", accepted, why, REHEARSAL)
        self.rig = self._loaded()

    def _about(self) -> None:
        names = " and ".join(one_line(device.eds.rpartition("/")[2]) for device in self.devices[:2])
        self.text.put("rig.name", "rehearsal" if self.rehearse else "draft")
        self.text.put("rig.description", f"Drafted for {names}, like the rig {self.like.rig.name}")
        self.text.head = [
            f"A rig file for {names}, drafted by `coulombus init`; what is not the devices' own is of the rig {self.like.rig.name}.",
            f"Each '{CHECK}' is a guess about the key below it: prove it, and delete the mark.",
            "Then `coulombus check --rig THIS_FILE` says what is left to decide.",
            "docs/rig-file.md explains every key.",
        ]
        switch = 'a real rig has a dead man\'s switch: deadman = "key", or "object:60FD:0:0x00010000" with the bits of your drive\'s input'
        self.text.note("host", switch, CHECK)
        if self.rehearse:
            self.text.head.append(
                f"{REHEARSAL}: this file is for `coulombus simulate` and `coulombus emulate`. On a real bus `coulombus run` refuses it until every "
                "mark of this kind is gone."
            )

    def _device(self, device: DraftDevice) -> None:
        """Set the keys of every device; the project's own devices are copied from the packaged rig."""
        packaged = load_rig(OWN_RIG).one_axis()
        if device.is_own:
            part = packaged.part(device.node).model_dump(by_alias=True, exclude_defaults=True)
            self._replace(device, part | {"node_id": device.node_id, "eds": device.eds})
            return
        base = self.like.motor if device.node == "motor" else self.like.brake
        part = base.model_dump(by_alias=True, exclude_defaults=True)
        if device.node not in ("motor", "brake"):
            part = {key: part[key] for key in ("heartbeat_s", "heartbeat_timeout_s")}
        for key in ("node_id", "eds", "vendor_id", "product_code", "sdo", "mode", "response_us"):
            part.pop(key, None)
        self._replace(device, {"node_id": device.node_id, "eds": device.eds, **part})
        at = _path(device)
        for subindex, key in enumerate(("vendor_id", "product_code"), 1):
            number, doubt = device.identity(subindex)
            if number is None:
                continue
            if doubt and self.rehearse:
                real = f" (0x{number:X}?)" if number else ""
                self.text.put(f"{at}.{key}", 0, f"a simulated device has 0, as its file tells none{real}", REHEARSAL)
            else:
                self.text.put(f"{at}.{key}", number, doubt)
        self.text.put(f"{at}.response_us", RESPONSE_US, "this device was not measured; see its manual")

    def _replace(self, device: DraftDevice, part: dict[str, Any]) -> None:
        if device.node in ("motor", "brake"):
            self.text.values[device.node] = part
        else:
            self.text.values.setdefault("sensor", {})[device.node] = part

    def _cycle(self, period_s: float) -> None:
        """Set the cycle, and the limits in encoder counts per cycle."""
        text, like = self.text, self.like
        longer = period_s / like.bus.period_s
        if longer != 1:
            text.put("bus.period_s", period_s, "shorter ones do not fit on the bus (`coulombus plan`)")
            text.put("bus.tpdo_window_s", round(WINDOW * period_s, 6))
        finer = (text.get("motor.encoder_counts_rev") * text.get("mechanics.ratio")) / (
            like.motor.encoder_counts_rev * like.mechanics.ratio
        )
        if finer * longer == 1:
            return
        position = self.devices[0].entry((0x6064, 0), "tpdo")
        half = (1 << (position.bits if position else 32) - 1) - 1  # a longer travel in a few cycles would be ambiguous
        for path, value, least in (
            ("law.velocity_band_counts", like.law.velocity_band_counts, 1),
            ("limits.encoder_jump_counts", like.limits.encoder_jump_counts, 4),
            ("limits.sign_check_counts", like.limits.sign_check_counts, 3),
        ):
            cycles = 1 if path == "limits.sign_check_counts" else longer
            largest = half // like.limits.missed_tpdo_cycles if path == "limits.encoder_jump_counts" else half
            whence = f"{value} in the rig {like.rig.name}, of an encoder with other counts at the handle"
            text.put(path, min(max(least, round(value * finer * cycles)), largest))
            text.note(path, whence)

    def _truth(self) -> None:
        """Set the simulated rig to the host's model."""
        text, simulated = self.text, load_rig(OWN_RIG).one_axis().model_dump(by_alias=True, exclude_defaults=True)
        for name in SIMULATED:
            if not text.get(name):
                text.put(name, simulated[name])
        for key, belief in SAME_IN_PLANT.items():
            text.put(f"plant.{key}", text.get(belief))
        text.note("plant", "the simulated rig has the values of this file", REHEARSAL)

    def _settled(self) -> Rig:
        """Return the rig, after fixing what can be fixed."""
        for _ in OPTIONAL:
            try:
                rig = self._loaded()
                break
            except RigError as error:
                self._without(error)
        else:
            rig = self._loaded()
        for period_s in PERIODS_S:
            if all(plan.fits for plan in plans(rig).values()):
                break
            if period_s > rig.bus.period_s:
                self._cycle(period_s)
                rig = self._loaded()
        return rig

    def _loaded(self) -> Rig:
        return load_rig_text(str(self.text), self.path)

    def _without(self, error: RigError) -> None:
        """Remove refused optional roles and allow longer for rare TPDOs; raise any other refusal."""
        seldom = [problem.text for problem in error.problems if MISSED in problem.remedy]
        if seldom and self.text.get(MISSED) < MOST_MISSED:
            self.text.put(MISSED, MOST_MISSED, "; ".join(seldom))
            return
        problems = {problem.role: str(problem) for problem in error.problems}
        refused = {role for role in problems if role not in OPTIONAL}
        if refused or not problems:
            texts = [f"{problem.node}: {problem}" for problem in error.problems if problem.role in refused]
            raise RigError(texts or error.errors, error.problems) from None
        for role, why in problems.items():
            if self.text.get(f"role.{role}.object") == "none":
                raise error
            self.text.drop(f"role.{role}")
            self.text.put(f"role.{role}.object", "none", why)


def _check_axis(device: DraftDevice) -> None:
    """Refuse an axis of which the drive has no object."""
    first = device.at(PROFILE_OBJECTS)
    if device.axis == 1 or any(axis_of(index) == device.axis for index in device.description.objects):
        return
    text = f"{device.description.path} has no object of axis {device.axis}, from {first:04X}h on"
    remedy = "take the EDS file of a drive that has this axis, or leave --axis out"
    problem = Problem("torque_setpoint", device.node, f"{first:04X}h", text, remedy)
    raise RigError([f"{device.node}: {problem}"], [problem])


def _law_from_anywhere(like: Axis) -> str:
    """Return the known rig's law; a file in that rig's folder gets its whole path."""
    file, colon, name = like.law.function.strip().rpartition(":")
    beside = like.law_directory / file
    return f"{beside.resolve()}:{name}" if colon and file.endswith(".py") and beside.exists() else like.law.function


def _path(device: DraftDevice) -> str:
    return device.node if device.node in ("motor", "brake") else f"sensor.{device.node}"
