"""The rig file as frozen models: bus, host, the controller's model, law, modes, limits, world.

The models are the schema: they define the range and meaning of every key. A test compares `docs/rig-file.md` with them,
and `rigs.errors` takes its texts from them. The devices and their roles are in `rigs.devices`, the simulated rig
([plant], [operator], [[phase]]) is in `rigs.plant`. The keys' names contain SI units. Times are seconds in the file;
`*_ns` properties give int64 nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic.config import JsonDict

from coulombus.system.foreign_text import first_control

__all__ = [
    "MODES",
    "MS",
    "About",
    "Bus",
    "Host",
    "Law",
    "Limits",
    "Mechanics",
    "Milliseconds",
    "Mode",
    "Modes",
    "Polarity",
    "Section",
    "WorldSection",
    "to_ns",
]


MODES = ("active", "passive", "hybrid")
MOST_DEVICES = 8
"""Maximum number of nodes of an axis that the host monitors."""
WORK_WINDOW_CYCLES = 4096
"""Longest window of the host's net-work watch [cycles]."""
MOST_DELAY_CYCLES = 16
"""Maximum cycles from sampling to actuation, for studies of a longer delay."""
WINDOW_CYCLES = 64
"""Longest window of the slow-velocity estimate [cycles]."""
BRAKE_FALL_S, RISE_TO_FALL = 0.01, 4.0
"""Default time in which a law may reduce the brake's torque from full to zero."""
CIA_301_BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
CHANNEL = r"^[a-z0-9_]{0,16}$"
DEADMAN = r"^(|none|key|object:[0-9A-Fa-f]{4}:[0-9A-Fa-f]{1,2}(:0x[0-9A-Fa-f]{1,16})?|gpio:gpiochip\d+:\d+(:low)?|socket:/.+)$"
LAW = r"^\s*((([A-Za-z_]\w*)(\.[A-Za-z_]\w*)*|[^:]+\.py):)?[A-Za-z_]\w*\s*$"


def to_ns(seconds: float) -> int:
    """Return `seconds` as integer nanoseconds."""
    return round(seconds * 1e9)


def _grid(unit_s: float, name: str, why: str) -> Any:
    """Return a validator for whole multiples of `unit_s`, in which the device counts."""

    def whole(value: float) -> float:
        if abs(value / unit_s - round(value / unit_s)) > 1e-6:
            raise ValueError(f"no whole number of {name}")
        return value

    return AfterValidator(whole), {"grid": f"a whole number of {name}, as {why} counts them"}


def _is_int(value: object) -> object:
    if type(value) is not int:
        raise ValueError("no integer")
    return value


def _plain(text: str) -> str:
    if first_control(text):
        raise ValueError("a control character")
    return text


_MS, MS = _grid(1e-3, "milliseconds", "the device")
_US, US = _grid(1e-6, "microseconds", "object 1006")
_NS, NS = _grid(1e-9, "nanoseconds", "the simulation")

Milliseconds = Annotated[float, _MS]
Microseconds = Annotated[float, _US]
Nanoseconds = Annotated[float, _NS]
Polarity = Annotated[Literal[1, -1], BeforeValidator(_is_int)]
PlainText = Annotated[str, AfterValidator(_plain)]
SAYS_PLAIN: JsonDict = {"range": "", "expected": "a text in double quotes, on one line, without control characters"}
SAYS_POLARITY: JsonDict = {"expected": "1 or -1"}


class Section(BaseModel):
    """A section of the rig file: frozen, no key beyond its own, no silent conversion, finite
    numbers.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


class About(Section):
    """[rig]: the rig's name."""

    name: PlainText = Field(
        min_length=1, description="short name, in titles and file names", json_schema_extra=SAYS_PLAIN
    )
    description: PlainText = Field("", description="one line for people", json_schema_extra=SAYS_PLAIN)


class Bus(Section):
    """[bus]: the CAN bus and the cycle."""

    channel: str = Field(
        "",
        pattern=CHANNEL,
        description="which bus, where the axes of a rig hang on several",
        json_schema_extra={"expected": "a name of up to 16 small letters, digits and _"},
    )
    bitrate_bit_s: int = Field(ge=10_000, le=20_000_000, description="bit rate of the CAN bus")
    period_s: Microseconds = Field(
        ge=1e-4, le=1.0, description="SYNC period, one cycle of the law", json_schema_extra=US
    )
    actuation: Literal["next_sync", "on_reception"] = Field(description="when the nodes act on an RPDO")
    tpdo_window_s: float = Field(gt=0, le=1.0, description="how long after SYNC the host waits for the TPDOs")
    delay_cycles: int | None = Field(
        None,
        ge=1,
        le=MOST_DELAY_CYCLES,
        description="cycles from sampling to actuation, for study",
        json_schema_extra={
            "expected": f"an integer from 1 to {MOST_DELAY_CYCLES}",
            "range": f"1 to {MOST_DELAY_CYCLES}",
        },
    )

    @property
    def period_ns(self) -> int:
        """SYNC period in nanoseconds."""
        return to_ns(self.period_s)

    @property
    def transmission(self) -> int:
        """Transmission type of the host's RPDOs (CiA 301 table 68): 1 acts on the next SYNC, 255 at
        once.
        """
        return 1 if self.actuation == "next_sync" else 255

    @property
    def cycles_to_actuation(self) -> int:
        """`delay_cycles`, or the one cycle that the bus takes."""
        return self.delay_cycles or 1


class Host(Section):
    """[host]: the host as a CANopen node."""

    node_id: int = Field(ge=1, le=127, description="the host's node id")
    heartbeat_s: Milliseconds = Field(
        ge=1e-3, le=65.535, description="period of the host's heartbeat", json_schema_extra=MS
    )
    sdo_timeout_s: float = Field(0.5, ge=0.01, le=60, description="how long the host waits for an SDO response")
    compute_s: float = Field(
        0.0, ge=0, le=1, description="longest time from the last TPDO to the RPDOs' sending; the planner counts it"
    )
    deadman: str = Field(
        "",
        pattern=DEADMAN,
        description="the dead man's switch",
        json_schema_extra={
            "expected": '"none", "key", "object:INDEX:SUB", "object:INDEX:SUB:MASK", "gpio:gpiochipN:LINE", '
            '"gpio:gpiochipN:LINE:low" or "socket:/PATH"'
        },
    )
    loss_limit: float = Field(0.05, ge=0, le=1, description="share of cycles with a missed deadline or a lost PDO")
    accept: tuple[str, ...] = Field(
        (),
        strict=False,
        max_length=64,
        description="what a device cannot do, and is acknowledged",
        json_schema_extra={"expected": "a list of texts, each as check prints it"},
    )


class Mechanics(Section):
    """[mechanics]: the controller's model of the device at the handle."""

    ratio: float = Field(gt=0, le=1e4, description="motor revolutions for one of the handle")
    motor_polarity: Polarity = Field(
        description="+1: positive 6071 drives the handle in its positive sense", json_schema_extra=SAYS_POLARITY
    )
    encoder_polarity: Polarity = Field(
        description="+1: 6064 grows in the handle's positive sense", json_schema_extra=SAYS_POLARITY
    )
    transducer_polarity: Polarity = Field(
        description="+1: the hand's torque in the positive sense reads positive", json_schema_extra=SAYS_POLARITY
    )
    inertia_kg_m2: float = Field(gt=0, le=1e3, description="inertia of the device at the handle")
    friction_Nm: float = Field(
        ge=0, le=1e3, description="identified Coulomb friction, coil off; the motor compensates it"
    )
    viscous_Nms_rad: float = Field(ge=0, le=1e3, description="identified viscous friction")
    cogging_Nm: float = Field(
        0.0,
        ge=0,
        le=1e3,
        description="identified amplitude of the motor's cogging at the handle; nothing compensates it",
    )
    cogging_periods: int = Field(
        0, ge=0, le=1000, description="identified periods of the cogging in one revolution of the motor; 0: none"
    )
    counts_turn: float | None = Field(
        None,
        gt=0,
        le=1e12,
        description="counts of the position in one turn of the handle, as measured between marks",
        json_schema_extra={"expected": "a number above 0, at most 1e12", "range": "above 0, at most 1e12"},
    )


class Law(Section):
    """[law]: the friction law and its options, and the tables of the laws' named parameters.

    Only the law knows the keys of [law.NAME], and it may be user-defined: `host.laws.parameters` checks them.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, dict[str, Any]] = Field(init=False)

    @property
    def tables(self) -> dict[str, dict[str, Any]]:
        """The tables [law.NAME], as in the file."""
        return dict(self.__pydantic_extra__ or {})

    function: str = Field(
        pattern=LAW,
        description="the compiled friction law",
        json_schema_extra={"expected": 'a law of the project, as "karnopp", "file.py:function" or "module:function"'},
    )
    stick_entry: Literal["continuous", "paper"] = Field(
        "continuous", description="where x_stuck is set on entry to stick"
    )
    brake_stick: Literal["hold", "spring"] = Field("hold", description="the brake's set-point while stuck")
    velocity_band_counts: int = Field(
        ge=0, le=2**31 - 1, description="stuck at or below this many counts in velocity_window_cycles"
    )
    velocity_window_cycles: int = Field(
        1, ge=1, le=WINDOW_CYCLES, description="cycles that the velocity is estimated over at most; 1: a difference"
    )
    level: Literal["brake", "felt"] = Field(
        "brake", description="what the law says: what the brake bears, or what the hand feels"
    )
    gain_ramp_s: float = Field(0.5, ge=0, le=60, description="the law's gain ramps in over this time")
    user: tuple[float, ...] = Field((), strict=False, max_length=16, description="numbers for a law of your own")


class Mode(Section):
    """[mode.active], [mode.passive], [mode.hybrid]: the law's parameters in this mode."""

    K_p_Nm_rad: float = Field(gt=0, le=1e7, description="stiffness of the stick spring")
    F_s_Nm: float = Field(ge=0, le=1e4, description="static friction")
    F_d_Nm: float = Field(ge=0, le=1e4, description="dynamic friction; the law coulomb's c")
    compensation: float = Field(ge=0, le=0.97, description="share of friction_Nm that the motor compensates")
    motor_limit_Nm: float = Field(ge=0, le=1e4, description="limit of the motor's torque, at the handle")
    inertia_compensation: float = Field(
        0.0, ge=0, le=0.8, description="share of the arm's inertia in the plane that the motors compensate"
    )


class Modes(Section):
    """[mode]: the modes that the rig may run in.

    Used as a mapping: ``rig.mode["active"]``, ``"active" in rig.mode``, ``list(rig.mode)``.
    """

    active: Mode | None = Field(None, description="force feedback by the motor alone")
    passive: Mode | None = Field(None, description="force feedback by the brake alone")
    hybrid: Mode | None = Field(None, description="brake for the friction, motor to compensate the device's own")

    def __getitem__(self, name: str) -> Mode:
        mode: Mode | None = getattr(self, name) if name in MODES else None
        if mode is None:
            raise KeyError(f"the rig has no mode '{name}'; it has {', '.join(self)}")
        return mode

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def __iter__(self) -> Iterator[str]:  # type: ignore[override]  # names, as a mapping does
        return (name for name in MODES if getattr(self, name) is not None)


SIGN_OF_STILL = 4
"""The sign check looks for this many times the motion of a still handle."""


class Limits(Section):
    """[limits]: trip limits, and the safe state."""

    torque_rate_Nm_s: float = Field(gt=0, le=1e9, description="rate of the motor's command at the handle")
    brake_torque_Nm: float = Field(ge=0, le=1e4, description="largest braking torque commanded")
    brake_fall_Nm_s: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="rate at which the law may let the brake's set-point fall; none: brake_torque_Nm in 10 ms",
    )
    brake_rise_Nm_s: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="rate at which the law may let the brake's set-point rise; none: four times that of its fall",
    )
    speed_rad_s: float = Field(gt=0, le=1e4, description="trip above this speed")
    encoder_jump_counts: int = Field(ge=1, le=2**31 - 1, description="trip above this many counts in one cycle")
    net_work_J: float = Field(gt=0, le=1e6, description="trip above this net work of the motor on the handle ...")
    net_work_window_s: float = Field(gt=0, le=60, description="... in this window")
    passivity_J: float = Field(
        0.01, gt=0, le=1e6, description="energy that the compensation may owe before the motor gives less of it"
    )
    travel_rad: Annotated[float, Field(gt=0, le=1e6)] | Literal["unlimited"] = Field(
        description="trip beyond +- this angle from the start",
        json_schema_extra={
            "range": "above 0, at most 1e6",
            "expected": 'a number above 0, at most 1e6, in rad, or "unlimited"',
        },
    )
    handle_mismatch_Nm: float = Field(
        gt=0, le=1e4, description="trip when transducer and brake command differ by more ..."
    )
    handle_mismatch_s: float = Field(gt=0, le=60, description="... for this long")
    handle_mismatch_share: float = Field(
        0.5,
        gt=0,
        le=1e6,
        description="... or, in the mean along the motion, by this share of the displayed torque; 0.6 of it gives a remark",
    )
    motor_mismatch_Nm: float | None = Field(
        None,
        gt=0,
        le=1e4,
        description="trip when the motor's measured torque is off from its commands by more; none: 0.2 of the rated torque",
    )
    missed_tpdo_cycles: int = Field(ge=1, le=1000, description="trip after this many cycles without a TPDO")
    still_s: float = Field(ge=0, le=60, description="before arming the handle is still this long ...")
    still_rad: float = Field(0.0004, ge=0, le=0.1, description="... within this angle, or a count if that is more, ...")
    still_handle_torque_Nm: float = Field(gt=0, le=1e4, description="... with less than this on it ...")
    still_timeout_s: float = Field(gt=0, le=600, description="... within this time")
    sign_check_rate_Nm_s: float = Field(gt=0, le=1e4, description="torque ramp of the sign check")
    sign_check_counts: int = Field(
        ge=1, le=2**31 - 1, description="motion that the sign check looks for, 4 times still_rad at least"
    )
    sign_check_torque_Nm: float = Field(gt=0, le=1e4, description="the sign check gives up above this torque")
    sign_check_travel_rad: float = Field(gt=0, le=1e3, description="the sign check aborts beyond this angle")
    safe_ramp_s: float = Field(ge=0, le=60, description="safe state: brake_torque_Nm is ramped to 0 in this time ...")
    safe_hold_s: float = Field(ge=0, le=60, description="... with pauses of this length in all, at most: ...")
    safe_speed_rad_s: float = Field(0.5, gt=0, le=1e4, description="... while the handle is faster than this")
    safe_brake_Nm: float | None = Field(None, ge=0, le=1e4, description="of version 0.2: without effect")

    @property
    def brake_fall(self) -> float:
        """Rate at which the law may let the brake's set-point fall [Nm/s]."""
        return max(self.brake_torque_Nm, 1e-9) / BRAKE_FALL_S if self.brake_fall_Nm_s is None else self.brake_fall_Nm_s

    @property
    def brake_rise(self) -> float:
        """Rate at which the law may let the brake's set-point rise [Nm/s]."""
        return RISE_TO_FALL * self.brake_fall if self.brake_rise_Nm_s is None else self.brake_rise_Nm_s

    def still_counts(self, rad_count: float) -> int:
        """Return the encoder's counts, of `rad_count` each, within which a handle is still."""
        return max(1, int(self.still_rad / abs(rad_count)))

    def sign_counts(self, rad_count: float) -> int:
        """Return the encoder's counts, of `rad_count` each, that decide its sign: a hand that drifts while it counts
        as still is not taken for the motor.
        """
        return max(self.sign_check_counts, int(SIGN_OF_STILL * self.still_rad / abs(rad_count)))

    @property
    def travel_limit_rad(self) -> float:
        """`travel_rad` as a number, infinite when unlimited."""
        return float("inf") if self.travel_rad == "unlimited" else float(self.travel_rad)


class WorldSection(Section):
    """[world]: what the display shows while no program sends a model."""

    rest: Literal["law", "free"] = Field(
        "law", description="what is displayed without a model: the rig's friction law, or nothing"
    )
    ramp_s: float = Field(0.2, ge=0.001, le=10, description="a model that is over fades within this time")
    longest_life_s: float = Field(1.0, ge=0.002, le=60, description="largest time to live of a model")
