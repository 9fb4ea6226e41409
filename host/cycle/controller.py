"""Records of the cycle's compiled step, built from a rig file and a mode."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count

import numpy as np

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.codec import PdoRecord
from coulombus.eds.drive_axis import axis_of, first_axis_object, of_axis
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.eds.pdo import fill
from coulombus.host.cycle.brake_model import DEFAULT_LAG_S
from coulombus.host.cycle.hand_over import set_hand_over
from coulombus.host.cycle.output_limits import (
    brake_end_Nm,
    brake_limit_raw,
    law_pushes,
    motor_limit_Nm,
)
from coulombus.host.cycle.plausibility import MEAN_S, SMOOTH_S
from coulombus.host.cycle.records import (
    AXIS,
    DRIVE_PDOS,
    AxisRecord,
    ControlRecord,
    Image,
    Phase,
    SignResult,
    Trip,
)
from coulombus.host.cycle.trip_text import trip_text
from coulombus.host.laws.law import Declaration, Parameters
from coulombus.host.laws.laws import BUILTIN_LAWS, LawError, load_declared, load_law
from coulombus.host.laws.parameters import axis_parameters
from coulombus.host.laws.plane.plane_laws import PlaneLaw
from coulombus.host.world.model_set_up import set_up_model
from coulombus.kernels.records import Records, new_records
from coulombus.rigs.axis import Axis
from coulombus.rigs.deadman_object import deadman_mask
from coulombus.rigs.device_services import beats, emcy_identifier, is_guarded
from coulombus.rigs.model import MOST_DEVICES
from coulombus.rigs.signals import RigPdo, Signal

__all__ = ["COUNTERS", "Controller"]

COUNTERS = (
    *("lost_pdos", "late_cycles", "stray_frames", "malformed_pdos", "malformed_services"),
    *("clipped_torque", "slowed_torque"),
    *("limited_by_drive", "clipped_setpoints", "slowed_setpoints", "negative_setpoints", "withheld_compensation"),
    "implausible_torque",
)
"""Counters that `Controller.counters` returns."""

TARGET_TORQUE, MAX_TORQUE = 0x6071, 0x6072
SIGN_HAND_S = 0.12
"""Averaging time of the sign check: a little more than the period of a hand's tremor (8-12 Hz)."""
SIGN_HAND_NM = 0.008
SETTLE_S = 0.05
CLIPPED_S = 0.5  # excess of clipped over unclipped time above which the host trips
REVERSAL_S, REVERSAL_MARGIN = 0.25, 1.15
"""Window in which reversals are counted, and the host trips above this multiple of the limit cycle's (docs/theory.md)."""
UNLOADED_S = 0.1  # time in which the safe state releases an unloaded handle
MISMATCH_SHARE = 0.2  # default of `limits.motor_mismatch_Nm`, as a share of the rated torque
MOTOR_LAG_S = 0.05
"""Time constant of the envelope of the motor's commands, and the longest time for which the measured
torque may lie outside it.
"""
ENABLE_TIMEOUT_S = 1.0

IMAGE_OF_SIGNAL = {
    "motor.controlword": Image.CONTROLWORD,
    "motor.target_torque_Nm": Image.TARGET_TORQUE,
    "motor.statusword": Image.STATUSWORD,
    "motor.position_rad": Image.POSITION,
    "motor.torque_Nm": Image.TORQUE,
    "motor.velocity_rad_s": Image.VELOCITY,
    "brake.statusword": Image.BRAKE_STATUSWORD,
    "brake.controlword": Image.BRAKE_CONTROLWORD,
    "brake.setpoint_Nm": Image.BRAKE_SETPOINT,
    "brake.handle_torque_Nm": Image.HANDLE_TORQUE,
    "brake.coil_current_A": Image.COIL_CURRENT,
    "brake.coil_temperature_degC": Image.COIL_TEMPERATURE,
}


def _cycles(seconds: float, period_s: float) -> int:
    return max(1, round(seconds / period_s))


def motor_mismatch_Nm(axis: Axis) -> float:
    """Return the largest permitted difference of the motor's measured torque from its commands [Nm]."""
    limit_Nm = axis.limits.motor_mismatch_Nm
    return MISMATCH_SHARE * axis.motor.rated_torque_Nm * axis.mechanics.ratio if limit_Nm is None else limit_Nm


def slot_of_signal(signal: Signal) -> int:
    """Return the slot of a signal's raw value in the process image; -1 if the host does not use it."""
    return int(Image.DEADMAN if signal.key.endswith(".deadman") else IMAGE_OF_SIGNAL.get(signal.key, -1))


def _slot_of(slots: dict[tuple[int, int], int]) -> Callable[[int, int], int]:
    return lambda index, subindex: slots.get((index, subindex), -1)


class Controller:
    """The host's compiled state for one run in one mode.

    Attributes
    ----------
    axis : one-record array of AXIS; `control`, `host`, `rpdos` and so on are views of its parts
    law_function : the friction law as a function pointer; of a joint unused
    declaration, parameters : of the law, of an arm's first joint of the law in the plane; None for the arm's other
        joints and a law without named parameters. If these are keys of [mode.NAME] and [law], `parameters` is None

    Raises
    ------
    coulombus.rigs.rig.RigError
        the law cannot be loaded; only a recording names it and it is not built in; or the drive
        cannot take a limit
    """

    def __init__(self, axis: Axis, mode: str, plane: PlaneLaw | None = None) -> None:
        self.axis = axis
        self.mode = mode
        self.declaration: Declaration | None
        self.parameters: Parameters | None
        if axis.joint:  # its share of the force comes from the plane; the parameters are with the first joint
            self.law_function = load_law("coulomb")
            self.declaration, self.parameters = (None, None) if plane is None else (plane.declaration, plane.parameters)
        else:
            self._load_law(axis)
        self.law_state = () if self.declaration is None else self.declaration.state
        self.records = new_records(AxisRecord)
        self.motion["dt_s"] = axis.bus.period_s
        self._set_law()
        pdos = axis.pdos()
        self.rpdos[:] = self._new_pdos([pdo for pdo in pdos if pdo.layout.direction == "rpdo"])
        self.tpdos[:] = self._new_pdos([pdo for pdo in pdos if pdo.layout.direction == "tpdo"])
        self.control[:] = self._new_control(pdos)
        set_up_model(self._parts["world"][0], axis, mode, self.control[0])
        for name in ("enabled_ns", "armed_ns", "full_gain_ns", "heard_ns", "foreign_id"):
            self.host[name] = -1
        self.host["deadman_ok"] = 1
        self.host["share"] = 1.0
        self.host["safe_from_Nm"] = -1.0
        constants = [constant.value for pdo in pdos for constant in pdo.constants]
        self.host["image"][0, Image.CONSTANT : Image.CONSTANT + len(constants)] = constants

    def _load_law(self, axis: Axis) -> None:
        """Set the law of an axis, its declaration and its parameters."""
        if axis.law_of_recording and axis.law.function not in BUILTIN_LAWS:
            expected = f"{' or '.join(BUILTIN_LAWS)}: any other law that only a recording names is a stranger's program, and is not run"
            raise axis.mistake("law.function", f"{expected}; if you trust it, name it yourself: --law FILE.py:FUNCTION")
        try:
            loaded = load_declared(axis.law.function.strip(), axis.law_directory)
        except LawError as error:
            raise axis.refusal("law.function", str(error)) from error
        self.law_function = loaded.pointer
        self.declaration = loaded.declaration
        self.parameters = axis_parameters(axis, loaded.declaration)

    @property
    def records(self) -> Records:
        """The whole state: an array of one AXIS record."""
        return self._records

    @records.setter
    def records(self, records: Records) -> None:
        self._records = records
        self._parts: dict[str, Records] = {name: records[name] for name in AXIS.names or ()}
        self._phase = records.view(np.ndarray)["host"]["phase"]

    @property
    def control(self) -> Records:
        """Limits and scales: an array of one record."""
        return self._parts["control"]

    @property
    def host(self) -> Records:
        """State of the cycle: an array of one record."""
        return self._parts["host"]

    @property
    def rpdos(self) -> Records:
        """PDOs that the host sends; `control.rpdos` of them are used."""
        part: Records = self._parts["rpdos"][0]
        return part

    @property
    def tpdos(self) -> Records:
        """PDOs that the host receives; `control.tpdos` of them are used."""
        part: Records = self._parts["tpdos"][0]
        return part

    @property
    def motion(self) -> Records:
        """The law's input: an array of one record."""
        return self._parts["motion"]

    @property
    def law(self) -> Records:
        """The law's parameters: an array of one record."""
        return self._parts["law"]

    @property
    def state(self) -> Records:
        """The law's state and output: an array of one record."""
        return self._parts["state"]

    @property
    def live(self) -> Records:
        """The changes of the law's parameters: an array of one record."""
        return self._parts["live"]

    def _set_law(self) -> None:
        mode, law, record = self.axis.mode[self.mode], self.axis.law, self.law[0]
        record["K_p"], record["F_s"], record["F_d"] = mode.K_p_Nm_rad, mode.F_s_Nm, mode.F_d_Nm
        record["velocity_band_counts"] = law.velocity_band_counts / law.velocity_window_cycles
        record["paper_entry"] = law.stick_entry == "paper"
        record["brake_spring"] = law.brake_stick == "spring"
        record["user"][: len(law.user)] = law.user
        if self.declaration is not None and self.parameters is not None:
            self.declaration.fill(record, self.parameters)

    def _new_pdos(self, pdos: list[RigPdo]) -> Records:
        records = new_records(PdoRecord, DRIVE_PDOS)
        records["cob_id"] = -1
        constant = count(int(Image.CONSTANT))
        for record, pdo in zip(records, pdos, strict=False):
            slots = {(s.index, s.subindex): slot for s in pdo.signals if (slot := slot_of_signal(s)) >= 0}
            slots |= {(fixed.index, fixed.subindex): next(constant) for fixed in pdo.constants}
            fill(record, pdo.layout, _slot_of(slots))
        return records

    def _new_control(self, pdos: tuple[RigPdo, ...]) -> Records:
        axis, mode, limits = self.axis, self.axis.mode[self.mode], self.axis.limits
        T = axis.bus.period_s
        control = new_records(ControlRecord)
        c = control[0]
        c["period_ns"], c["window_ns"] = round(T * 1e9), round(axis.bus.tpdo_window_s * 1e9)
        c["sync_cob_id"], c["host_id"] = CobId.SYNC, axis.host.node_id
        c["nodes"] = len(axis.devices)
        for k, node in enumerate(axis.devices):
            c["node_id"][k] = axis.part(node).node_id
            description = axis.description(node)
            c["emcy_id"][k] = emcy_identifier(description, axis.part(node).node_id)
            c["heartbeat_timeout_ns"][k] = round(axis.part(node).heartbeat_timeout_s * 1e9) if beats(description) else 0
            if is_guarded(description):
                c["guarded"] |= 1 << k
                c["guard_ns"] = round(axis.host.heartbeat_s * 1e9)
        c["heartbeat_ns"] = round(axis.host.heartbeat_s * 1e9)
        self._set_tpdos(c, pdos)
        c["motor_active"], c["brake_active"] = self.mode == "active", self.mode in ("passive", "hybrid")
        c["is_hybrid"] = self.mode == "hybrid"

        self._set_scales(c)

        c["friction_Nm"] = axis.mechanics.friction_Nm
        c["compensation_Nm"] = mode.compensation * axis.mechanics.friction_Nm
        c["viscous"] = axis.mechanics.viscous_Nms_rad
        c["delay_cycles"] = axis.bus.cycles_to_actuation
        c["velocity_band_counts"] = axis.law.velocity_band_counts
        c["slide_band_counts"] = axis.law.velocity_band_counts / axis.law.velocity_window_cycles
        c["window_cycles"], c["level_is_felt"] = axis.law.velocity_window_cycles, axis.law.level == "felt"
        c["inertia"] = axis.mechanics.inertia_kg_m2
        for name, lag_s in (("coil_step", axis.brake.coil_lag_s), ("fluid_step", axis.brake.fluid_lag_s)):
            c[name] = 1.0 - math.exp(-T / lag_s) if lag_s > 0 else 0.0
        iron = axis.brake.iron
        c["iron_direct"] = 1.0
        if iron is not None:
            plays = c["iron_plays"] = len(iron.play_Nm)
            c["iron_r"][:plays], c["iron_w"][:plays] = iron.play_Nm, iron.weights
            c["iron_direct"] = 1.0 - math.fsum(iron.weights)
        c["gain_step"] = T / axis.law.gain_ramp_s if axis.law.gain_ramp_s > 0 else 1.0

        c["motor_limit_raw"] = self.motor_limit_raw(float(c["motor_Nm_raw"]))
        c["motor_rate_Nm"] = limits.torque_rate_Nm_s * T
        c["brake_limit_raw"] = brake_limit_raw(axis)
        c["brake_limit_Nm"] = min(limits.brake_torque_Nm, brake_end_Nm(axis))
        c["brake_fall_Nm"], c["brake_rise_Nm"] = limits.brake_fall * T, limits.brake_rise * T
        c["reversal_decay"] = math.exp(-T / REVERSAL_S)
        cycle_s = 4.0 * T * (2.0 if axis.bus.actuation == "next_sync" else 1.0)  # friction's limit cycle at its fastest
        c["most_reversals"] = REVERSAL_MARGIN * 2.0 * REVERSAL_S / cycle_s
        c["clipped_cycles"] = _cycles(CLIPPED_S, T)
        c["speed_limit"], c["jump_counts"] = limits.speed_rad_s, limits.encoder_jump_counts
        c["net_work_J"] = limits.net_work_J
        c["net_work_cycles"] = _cycles(limits.net_work_window_s, T)
        c["stores"], c["is_joint"] = int(law_pushes(axis)), int(axis.joint)
        c["travel_rad"] = math.inf if limits.travel_rad == "unlimited" else float(limits.travel_rad)
        handle = axis.allocation.bound.get("handle_torque") is not None
        observed = handle and self.mode in ("active", "hybrid")
        c["passivity_J"] = limits.passivity_J if observed else math.inf
        measured = axis.allocation.bound.get("torque") is not None
        c["motor_mismatch_Nm"] = motor_mismatch_Nm(axis) if measured else math.inf
        c["motor_mismatch_cycles"], c["motor_lag_decay"] = _cycles(MOTOR_LAG_S, T), math.exp(-T / MOTOR_LAG_S)
        c["mismatch_Nm"] = limits.handle_mismatch_Nm if handle else math.inf
        c["mismatch_share"] = limits.handle_mismatch_share
        c["smooth_step"], c["mean_step"] = 1.0 - math.exp(-T / SMOOTH_S), 1.0 - math.exp(-T / MEAN_S)
        c["mismatch_cycles"] = _cycles(limits.handle_mismatch_s, T)
        c["missed_cycles"] = limits.missed_tpdo_cycles
        c["coil_limit_A2"] = axis.brake.coil_continuous_A**2
        c["coil_decay"] = math.exp(-T / axis.brake.coil_time_constant_s)
        c["brake_lag_decay"] = math.exp(-T / DEFAULT_LAG_S)

        c["still_counts"], c["still_cycles"] = limits.still_counts(float(c["rad_count"])), _cycles(limits.still_s, T)
        c["still_handle_Nm"] = limits.still_handle_torque_Nm if handle else math.inf
        c["still_timeout_cycles"] = _cycles(limits.still_timeout_s, T)
        c["enable_timeout_cycles"] = _cycles(ENABLE_TIMEOUT_S, T)
        c["sign_check"] = c["motor_limit_raw"] > 0
        c["sign_step_Nm"] = limits.sign_check_rate_Nm_s * T
        c["sign_counts"], c["sign_torque_Nm"] = limits.sign_counts(float(c["rad_count"])), limits.sign_check_torque_Nm
        c["sign_travel_counts"] = math.ceil(limits.sign_check_travel_rad / abs(c["rad_count"]))
        c["sign_hand_Nm"], c["sign_hand_cycles"] = SIGN_HAND_NM if handle else math.inf, _cycles(SIGN_HAND_S, T)
        c["settle_cycles"] = _cycles(SETTLE_S, T)
        self._check_counts(c)

        switch = any(signal.name.endswith(".deadman") for pdo in pdos for signal in pdo.signals)
        c["deadman_slot"] = Image.DEADMAN if switch else -1
        c["deadman_mask"] = deadman_mask(axis.host.deadman)

        c["law_keeps"] = sum(size for _, size in self.law_state)
        set_hand_over(c, axis, self.mode)
        ramp_cycles = _cycles(limits.safe_ramp_s, T)
        c["safe_longest_cycles"] = ramp_cycles + round(limits.safe_hold_s / T)
        c["release_Nm"] = c["brake_limit_Nm"] / ramp_cycles
        c["unloaded_Nm"] = max(c["brake_limit_Nm"] / _cycles(UNLOADED_S, T), c["release_Nm"])
        c["release_counts"] = limits.safe_speed_rad_s * T / abs(c["rad_count"])
        return control

    def _check_counts(self, c: ControlRecord) -> None:
        """Refuse limits in radians for which the encoder is too coarse."""
        limits, rad_count = self.axis.limits, abs(float(c["rad_count"]))
        speed, travel = rad_count / self.axis.bus.period_s, int(c["sign_counts"]) * rad_count
        if speed >= limits.speed_rad_s:
            expected = f"more than {speed:.3g}: one encoder count in a cycle is that fast already; take a longer bus.period_s or a finer encoder"
            raise self.axis.mistake("limits.speed_rad_s", expected)
        if c["sign_check"] and travel >= limits.sign_check_travel_rad:
            largest_counts = math.ceil(limits.sign_check_travel_rad / rad_count) - 1
            expected = f"at most {largest_counts}: {c['sign_counts']} counts are {travel:.3g} rad, and limits.sign_check_travel_rad ends before that"
            raise self.axis.mistake("limits.sign_check_counts", expected)

    def _set_tpdos(self, c: ControlRecord, pdos: tuple[RigPdo, ...]) -> None:
        """Set the bit masks of the TPDOs: awaited ones, those by timer, and the one with the position."""
        tpdos = [pdo for pdo in pdos if pdo.layout.direction == "tpdo"]
        c["rpdos"], c["tpdos"] = len(pdos) - len(tpdos), len(tpdos)
        for i, pdo in enumerate(tpdos):
            c["every_cycle" if pdo.every_cycle else "by_timer"] |= 1 << i
            for signal, entry in zip(pdo.signals, pdo.layout.entries, strict=True):
                if signal.key == "motor.position_rad":
                    c["position_mask"], c["position_half"] = 1 << i, 1 << (entry.bits - 1)
        c["awaited"] = c["every_cycle"] or c["by_timer"]

    def _set_scales(self, c: ControlRecord) -> None:
        """Set the scale of each role, and the substitutes of absent roles."""
        bound = self.axis.allocation.bound
        c["rad_count"] = bound["position"].scale
        c["motor_Nm_raw"] = bound["torque_setpoint"].scale
        brake, torque, handle, coil = map(bound.get, ("brake_setpoint", "torque", "handle_torque", "coil_current"))
        assert brake is not None
        c["torque_Nm_raw"], c["torque_commanded"] = (0.0, 1.0) if torque is None else (torque.scale, 0.0)
        c["handle_Nm_raw"], c["handle_offset_Nm"] = (0.0, 0.0) if handle is None else (handle.scale, handle.offset)
        c["coil_A_raw"], c["coil_A_Nm"] = (0.0, self.axis.brake.coil_A_Nm) if coil is None else (coil.scale, 0.0)
        c["brake_Nm_raw"], c["brake_points"] = abs(brake.scale), len(brake.table)
        for k, (raw, Nm) in enumerate(brake.table):
            c["brake_raw_at"][k], c["brake_Nm_at"][k] = raw, Nm
        c["brake_is_drive"] = bound.get("brake_statusword") is not None
        c["brake_ramps"] = is_own("brake", identity_from_1018h(self.axis.description("brake")))

    def drive_limit_pm(self) -> int:
        """Return the torque limit for the drive, in per mille of the rated torque.

        With set-point 6071h this is the host's limit; with another set-point it is converted from Nm.
        """
        setpoint = self.axis.allocation.bound["torque_setpoint"]
        limit = int(self.control["motor_limit_raw"][0])
        if first_axis_object(setpoint.entry.index) == TARGET_TORQUE:
            return limit
        rated_Nm = self.axis.motor.rated_torque_Nm * self.axis.mechanics.ratio
        return math.ceil(limit * abs(setpoint.scale) / rated_Nm * 1000)

    def motor_limit_raw(self, motor_Nm_raw: float) -> int:
        """Return the motor's torque limit in counts of its set-point (6071h: per mille), rounded down."""
        limit = math.floor(motor_limit_Nm(self.axis, self.mode) / abs(motor_Nm_raw) + 1e-9)
        motor, entry = self.axis.description("motor"), self.axis.allocation.bound["torque_setpoint"].entry
        target = motor.variable(entry.index, entry.subindex)
        ends = [(entry.index, target.largest)]
        per_mille, max_torque = (
            first_axis_object(entry.index) == TARGET_TORQUE,
            of_axis(MAX_TORQUE, axis_of(entry.index)),
        )
        if per_mille and motor.has(max_torque, 0):
            ends.insert(0, (max_torque, motor.variable(max_torque, 0).largest))
        if target.low is not None and target.low < 0:
            ends.append((entry.index, -target.low))
        index, end = min(ends, key=lambda pair: pair[1])
        if limit > end:
            raise self.axis.mistake(
                f"mode.{self.mode}.motor_limit_Nm",
                f"at most {end * abs(motor_Nm_raw):.4g}: the drive's {index:04X}h ends at {end:g}{' per mille' if per_mille else ''}",
            )
        return limit

    def can_ids(self) -> set[int]:
        """Return the identifiers of the CANopen objects of the axis' nodes."""
        c = self.control[0]
        nodes = list(map(int, c["node_id"][: c["nodes"]]))
        services = {base + node for base in (CobId.SDO_TX, CobId.SDO_RX, CobId.HEARTBEAT) for node in nodes}
        services |= set(map(int, c["emcy_id"][: c["nodes"]]))
        return services | {
            int(pdo["cob_id"]) for pdos in (self.rpdos, self.tpdos) for pdo in pdos if pdo["cob_id"] >= 0
        }

    def start(self, t_ns: int) -> None:
        """Begin with the first cycle at `t_ns`; all nodes count as heard at that time."""
        h = self.host[0]
        h["next_ns"] = h["heartbeat_due_ns"] = h["guard_due_ns"] = t_ns
        self.host["heard_ns"], self.host["nmt"] = [t_ns] * MOST_DEVICES, [NmtState.OPERATIONAL] * MOST_DEVICES
        h["phase"] = Phase.STILL

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state: the normal end of a run, or with the reason `trip`."""
        self.host["stop"] = max(1, int(trip))

    @property
    def phase(self) -> Phase:
        """Phase of the cycle."""
        return Phase(int(self._phase[0]))

    @property
    def trip(self) -> str | None:
        """Text of the reason for the safe state, or None."""
        return trip_text(self.axis, self.control, self.host)

    @property
    def sign_result(self) -> SignResult:
        """Outcome of the sign check."""
        return SignResult(int(self.host["sign_result"][0]))

    def counters(self) -> dict[str, int]:
        """Return the cycle's counters."""
        return {name: int(self.host[name][0]) for name in COUNTERS}
