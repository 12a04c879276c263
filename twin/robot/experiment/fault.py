"""Catalogue of fault kinds, and the [[fault]] tables of an experiment.

`docs/faults_reference.md` shows the kinds as a table. Each kind has its own magnitude, with its unit in the key.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal, NamedTuple

from pydantic import create_model

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.settings import Settings, optional, setting
from twin.robot.experiment.mistakes import check_table, numbered_tables
from twin.robot.experiment.schema import whole_ticks

Mechanism = Literal["counts", "message", "command", "drive", "parameter", "body"]
"""Implementation of a fault. counts, message, command: a component in a wire. drive: a component behind a drive.
parameter: a component that writes into another one's memory. body: a motion of the surface."""

Detection = Literal["yes", "if large", "no"]

GLITCH_SHARE = 0.02
"""Default share of samples hit, for kinds that also have a magnitude: ten per second at 2 ms."""
ANY_MAGNITUDE = 0.0
"""Threshold that every magnitude reaches, also for kinds without one."""
POSITIVE_BOUNDS = {"gt": 0.0}
SHARE_BOUNDS = {"gt": 0.0, "le": 1.0}
MAX_LISTED_NAMES = 10
_JOINT_TARGETS = tuple(f"joint_{i}" for i in (1, 2, 3))
_DRIVE_TARGETS = tuple(f"drive_{i}" for i in (1, 2, 3))
_ENCODER_TARGETS = tuple(f"{place}_encoder_{i}" for place in ("joint", "motor") for i in (1, 2, 3))
TARGET_GROUPS: dict[str, tuple[str, ...]] = {
    "all drives": _DRIVE_TARGETS,
    "all encoders": _ENCODER_TARGETS,
    "all joint encoders": _ENCODER_TARGETS[:3],
    "all motor encoders": _ENCODER_TARGETS[3:],
    "all joints": _JOINT_TARGETS,
    "power": ("drives",),
}
"""Groups of targets with a common cause: one bus or driver board, one supply, one batch or one repair."""
_SAME_ENCODER = "the same encoder gives force and pose"
_BELIEVED_SPRING = "the estimated force is the deflection times the believed k_s, so a wrong k_s has no symptom"
_NO_TRUE_FORCE = "no sensor measures the force itself, so the estimate cannot be compared"
_DOES_NOT_FOLLOW = "the motor encoder does not follow the command"
_DEFLECTION_JUMP = "the deflection changes faster than shaft and link can move"
NO_END_TICK = 1 << 62
"""End tick of a permanent fault."""


class DetectionThreshold(NamedTuple):
    """Smallest magnitude of a permanent fault that the safety monitor is expected to detect, stated before any run.

    `free` is for an onset in free motion, `contact` for one in contact; None if it is undetectable.
    """

    free: float | None = None
    contact: float | None = None


ALWAYS_DETECTED, NEVER_DETECTED = DetectionThreshold(ANY_MAGNITUDE, ANY_MAGNITUDE), DetectionThreshold()


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault of the catalogue: targets, magnitudes, and the expected detection by the monitor.

    Attributes:
        targets: possible targets; the first one is the default.
        meaning: effect, in one line.
        threshold: smallest magnitude that the safety monitor is expected to detect, from the encoders' counts, the
            counter of their messages and the controller's command.
        reason: symptom that the monitor detects, or the reason for its absence.
        unit: unit of the magnitude in its TOML key ("share" and "factor" are pure numbers); None without a magnitude.
        magnitudes: small, medium and large, in that unit, for matrices of faults.
        bounds: bounds of the magnitude in that unit, named as in pydantic.
        has_share: whether a second number, `share`, sets the share of samples that it hits.
        excess_from: smallest magnitude expected to raise the force above the monitor's limit; None if there is none.
    """

    mechanism: Mechanism
    targets: tuple[str, ...]
    meaning: str
    threshold: DetectionThreshold
    reason: str
    unit: str | None = None
    magnitudes: tuple[float, float, float] | None = None
    bounds: Mapping[str, float] = field(default_factory=dict, hash=False)
    has_share: bool = False
    excess_from: float | None = None

    @property
    def detection(self) -> Detection:
        """When the safety monitor is expected to detect this kind of fault: always, in some cases, or never."""
        return "yes" if self.threshold == ALWAYS_DETECTED else "no" if self.threshold == NEVER_DETECTED else "if large"

    def expects_detection(self, magnitude: float | None, in_contact: bool) -> bool:
        """Whether the safety monitor is expected to detect a fault of this kind and magnitude."""
        return self.is_reached(self.threshold.contact if in_contact else self.threshold.free, magnitude)

    def expects_excess(self, magnitude: float | None) -> bool:
        """Whether a fault of this kind and magnitude is expected to raise the force above the monitor's limit."""
        return self.is_reached(self.excess_from, magnitude)

    def is_reached(self, start: float | None, magnitude: float | None) -> bool:
        """Whether a magnitude of the catalogue, of either sign, is at least `start`; False if `start` is None."""
        if start is None or start == ANY_MAGNITUDE or self.magnitudes is None or magnitude is None:
            return start is not None
        # for some kinds a smaller number is a larger fault
        size = math.copysign(magnitude, self.magnitudes[0])
        return size in self.magnitudes and self.magnitudes.index(size) >= self.magnitudes.index(start)

    @property
    def magnitude_key(self) -> str | None:
        """TOML key of this fault kind's magnitude; None if it has no magnitude."""
        return f"magnitude_{self.unit}" if self.unit else None

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of targets, such as `all drives`, that this kind of fault can hit."""
        return tuple(group for group, members in TARGET_GROUPS.items() if set(members) <= set(self.targets))

    def members(self, target: str) -> tuple[str, ...]:
        """Return the single targets of a fault's `target`, which may be a group such as `all drives`."""
        return TARGET_GROUPS[target] if target in self.groups else (target,)


_ENCODER_KINDS = {
    "encoder_bias": FaultKind(
        "counts", _ENCODER_TARGETS, "a constant angle is added to the count", DetectionThreshold(2.0, 2.0),
        f"{_DEFLECTION_JUMP} at the onset; afterwards {_SAME_ENCODER}",
        "deg", (0.1, 0.5, 2.0),
    ),
    "encoder_drift": FaultKind(
        "counts", _ENCODER_TARGETS, "an angle that grows at a constant speed is added to the count",
        DetectionThreshold(2.0, 2.0),
        f"{_SAME_ENCODER}, and the force loop corrects the estimated force; motors whose speed droops under load "
        "reveal the force, with others only the limits of deflection, depth or workspace end the drift",
        "deg_per_s", (0.1, 0.5, 2.0), excess_from=2.0,
    ),
    "encoder_quantisation": FaultKind(
        "counts", _ENCODER_TARGETS, "the count has coarser steps", DetectionThreshold(2.0, 2.0),
        f"{_DEFLECTION_JUMP} at a step; fine steps look like a healthy encoder of lower resolution",
        "deg", (0.2, 0.5, 2.0), POSITIVE_BOUNDS,
    ),
    "encoder_dropout_hold": FaultKind(
        "counts", _ENCODER_TARGETS, "random samples are lost and repeat the last good count",
        DetectionThreshold(1.0, 1.0),
        "a count is constant although the command moves the shaft; single lost samples look like a slow shaft",
        "share", (0.02, 0.2, 1.0), SHARE_BOUNDS,
    ),
    "encoder_dropout_zero": FaultKind(
        "counts", _ENCODER_TARGETS, "random samples are lost and read 0", ALWAYS_DETECTED,
        f"{_DEFLECTION_JUMP}, unless the shaft is near 0",
        "share", (0.001, 0.02, 1.0), SHARE_BOUNDS,
    ),
    "encoder_dropout_nan": FaultKind(
        "counts", _ENCODER_TARGETS, "random samples are lost and read NaN", ALWAYS_DETECTED,
        "a count is NaN",
        "share", (0.001, 0.02, 1.0), SHARE_BOUNDS,
    ),
    "encoder_stuck": FaultKind(
        "counts", _ENCODER_TARGETS, "the count is frozen", ALWAYS_DETECTED,
        "the count is constant although the command moves the shaft; no symptom at rest",
    ),
    "encoder_glitch": FaultKind(
        "counts", _ENCODER_TARGETS, "an angle is added to random single samples, a share of all",
        DetectionThreshold(5.0, 5.0), _DEFLECTION_JUMP,
        "deg", (0.5, 5.0, 90.0), has_share=True,
    ),
    "encoder_flip": FaultKind(
        "counts", _ENCODER_TARGETS, "the sign of the count is inverted", ALWAYS_DETECTED,
        f"{_DEFLECTION_JUMP}, unless the shaft is near 0",
    ),
    "encoder_swap": FaultKind(
        "counts", _ENCODER_TARGETS, "the channel is swapped with the next one (1-2, 2-3, 3-1)", NEVER_DETECTED,
        f"no symptom in a symmetric pose, which the matrix may hit; where the two angles differ, {_DEFLECTION_JUMP}",
    ),
}  # fmt: skip

_MESSAGE_KINDS = {
    "sample_delay": FaultKind(
        "message", ("encoder",), "the messages of both encoders arrive late", DetectionThreshold(10.0, 10.0),
        "the message counter stops for the delay at the onset; afterwards only a common clock would show the delay",
        "ms", (2.0, 10.0, 50.0), POSITIVE_BOUNDS,
    ),
    "sample_jitter": FaultKind(
        "message", ("encoder",), "messages arrive after a random delay up to the magnitude",
        DetectionThreshold(10.0, 10.0),
        "the message counter stops and then jumps",
        "ms", (2.0, 10.0, 50.0), POSITIVE_BOUNDS,
    ),
    "sample_loss": FaultKind(
        "message", ("encoder",), "random messages are lost; the reader keeps the last one",
        DetectionThreshold(0.2, 0.2),
        "the message counter stops",
        "share", (0.02, 0.2, 1.0), SHARE_BOUNDS,
    ),
    "controller_overrun": FaultKind(
        "message", ("controller",), "commands leave the controller late", NEVER_DETECTED,
        "commands carry no counter, so only the effect on the motion is visible",
        "ms", (2.0, 10.0, 50.0), POSITIVE_BOUNDS,
    ),
    "command_held": FaultKind(
        "message", ("controller", "bus"), "random commands are lost; the receiver keeps the last one",
        DetectionThreshold(1.0, None),
        "from the controller, a repeated command looks like any other until the force reaches a limit; on the bus, "
        "the motors keep their speed and deviate from the command as soon as it changes",
        "share", (0.2, 0.8, 1.0), SHARE_BOUNDS,
    ),
    "command_lost": FaultKind(
        "message", ("controller", "bus"), "random commands are lost; the receiver reads zero speed",
        NEVER_DETECTED,
        "the robot is at rest, or slower than commanded",
        "share", (0.2, 0.8, 1.0), SHARE_BOUNDS,
    ),
}  # fmt: skip

_PARAMETER_KINDS = {
    "spring_softened": FaultKind(
        "parameter", _JOINT_TARGETS, "the stiffness of the joint's spring is multiplied by this factor", NEVER_DETECTED,
        _BELIEVED_SPRING,
        "factor", (0.9, 0.7, 0.4), POSITIVE_BOUNDS,
    ),
    "spring_broken": FaultKind(
        "parameter", _JOINT_TARGETS, "the spring of the joint transmits no torque", ALWAYS_DETECTED,
        "in free air the link leaves the motor at once, and the deflection exceeds the force limit; in contact, "
        "friction may hold the platform for seconds while the true force grows",
    ),
    "stiffness_change": FaultKind(
        "parameter", ("contact",), "the stiffness of the surface is multiplied by this factor", NEVER_DETECTED,
        "while pressing, the force acts in the same tick, before the springs deflect, so the monitor trips after the "
        "peak. A body that takes 20 ms to stiffen trips the force rate in time",
        "factor", (1.5, 3.0, 10.0), POSITIVE_BOUNDS, excess_from=3.0,
    ),
    "backlash_growth": FaultKind(
        "parameter", _JOINT_TARGETS, "the half width of the dead zone grows by this angle of the motor shaft",
        NEVER_DETECTED,
        "the estimator counts the travel in the dead zone as deflection",
        "deg", (0.1, 0.5, 2.0), {"ge": 0.0},
    ),
    "joint_friction": FaultKind(
        "parameter", _JOINT_TARGETS, "viscous friction is added to the joint", NEVER_DETECTED,
        "it acts between spring and platform, so the spring's torque and the force at rest stay right",
        # the plant's explicit integration is stable up to 0.81 at the rim of the workspace, tick 1 ms, one substep
        "Nm_s_per_rad", (0.01, 0.05, 0.5), {"ge": 0.0, "le": 0.8},
    ),
    "belt_slip": FaultKind(
        "parameter", _JOINT_TARGETS, "the belt slips by this angle of the motor shaft, permanently",
        DetectionThreshold(-10.0, -30.0),
        f"in free air the platform is accelerated, which looks like a force; in contact the body holds it; "
        f"afterwards {_SAME_ENCODER}",
        # a negative slip deflects the spring: the platform presses harder
        "deg", (-2.0, -10.0, -30.0), excess_from=-30.0,
    ),
    "belief_k_s": FaultKind(
        "parameter", ("estimator",), "the believed spring stiffness is multiplied by this factor", NEVER_DETECTED,
        _NO_TRUE_FORCE,
        "factor", (1.05, 1.2, 1.5), POSITIVE_BOUNDS,
    ),
    "belief_eta": FaultKind(
        "parameter", ("estimator",), "the believed belt efficiency is multiplied by this factor", NEVER_DETECTED,
        _NO_TRUE_FORCE,
        "factor", (0.95, 0.85, 0.7), POSITIVE_BOUNDS,
    ),
}  # fmt: skip

_DRIVE_KINDS = {
    "drive_runaway": FaultKind(
        "drive", _DRIVE_TARGETS, "the shaft turns at this speed regardless of the command, until the power is cut",
        ALWAYS_DETECTED,
        f"{_DOES_NOT_FOLLOW}; only cutting the power stops it",
        "rad_per_s", (0.5, 2.0, 8.0),
    ),
    "drive_freewheel": FaultKind(
        "drive", _DRIVE_TARGETS, "the drive has no torque: the spring turns its rotor", ALWAYS_DETECTED,
        f"{_DOES_NOT_FOLLOW}, and the deflection vanishes",
    ),
    "drive_dead": FaultKind(
        "drive", _DRIVE_TARGETS, "the brake closes: the shaft does not turn", ALWAYS_DETECTED,
        f"{_DOES_NOT_FOLLOW}; no symptom at rest",
    ),
    "joint_jam": FaultKind(
        "drive", _DRIVE_TARGETS, "an object blocks the gear: the shaft turns upwards only",
        DetectionThreshold(ANY_MAGNITUDE, None),
        f"{_DOES_NOT_FOLLOW} as soon as it leads downwards; a retraction still works",
    ),
    "drive_failure": FaultKind(
        "drive", _DRIVE_TARGETS, "the step of the drive fails and ends the run", ALWAYS_DETECTED,
        "the run ends with an error message that names the fault",
    ),
    "drive_saturation": FaultKind(
        "command", _DRIVE_TARGETS, "the speed of the drive is limited to this", DetectionThreshold(0.3, 0.3),
        f"{_DOES_NOT_FOLLOW} above the limit; no symptom below",
        "rad_per_s", (2.0, 0.3, 0.05), {"ge": 0.0},
    ),
    "brown_out": FaultKind(
        "command", ("drives",), "the supply sags: the speed of all drives is limited to this share of their maximum",
        DetectionThreshold(0.05, 0.05), f"{_DOES_NOT_FOLLOW} above the limit; no symptom below",
        "share", (0.5, 0.05, 0.01), SHARE_BOUNDS,
    ),
    "power_off": FaultKind(
        "command", ("power",), "the supply of all drives fails; [drive.unpowered] describes drives without power",
        ALWAYS_DETECTED, f"{_DOES_NOT_FOLLOW}; no symptom at rest",
    ),
}  # fmt: skip

_BODY_KINDS = {
    "surface_jump": FaultKind(
        "body", ("contact",), "the surface jumps up by this distance", DetectionThreshold(10.0, 5.0),
        "force and force rate jump",
        "mm", (2.0, 5.0, 10.0), excess_from=10.0,
    ),
    "contact_loss": FaultKind(
        "body", ("contact",), "the surface drops by this distance", NEVER_DETECTED,
        "the springs accelerate the platform after the surface, above the speed limit only after a firm press; the "
        "task ends by itself",
        "mm", (1.0, 5.0, 20.0), POSITIVE_BOUNDS,
    ),
    "breathing": FaultKind(
        "body", ("contact",), "the surface rises and falls with this amplitude at 0.25 Hz", NEVER_DETECTED,
        "a healthy body moves likewise, and the force loop follows it",
        "mm", (0.5, 2.0, 5.0), POSITIVE_BOUNDS,
    ),
}  # fmt: skip

FAULT_KINDS: dict[str, FaultKind] = {
    **_ENCODER_KINDS,
    **_MESSAGE_KINDS,
    **_PARAMETER_KINDS,
    **_DRIVE_KINDS,
    **_BODY_KINDS,
}


def find_kind(number: int, name: str) -> FaultKind:
    """Look up a kind of fault by name in the catalogue; `number` is the fault's number for the error message."""
    if name not in FAULT_KINDS:
        raise InputRefused(f'[[fault]] {number} kind = "{name}": {expected_names(name, tuple(FAULT_KINDS))}')
    return FAULT_KINDS[name]


def refuse_target(number: int, kind: str, target: str) -> None:
    """Refuse a fault's target that is neither a target nor a target group of its kind."""
    targets = FAULT_KINDS[kind].targets + FAULT_KINDS[kind].groups
    if target not in targets:
        raise InputRefused(f'[[fault]] {number} target = "{target}" of {kind}: {expected_names(target, targets)}')


def expected_names(got: str, names: tuple[str, ...]) -> str:
    """Return the end of an error message that lists the expected names and suggests the most similar one.

    For many names only the likely ones are listed.
    """
    hint = nearest(got, names, "", 3)
    if len(names) > MAX_LISTED_NAMES:
        return hint or "no such kind; docs/faults_reference.md lists them all, twin faults tries them"
    return "expected " + ", ".join(f"'{name}'" for name in names) + (f"; {hint}" if hint else "")


@dataclass(frozen=True)
class Fault:
    """A fault of an experiment: kind, target, time span and magnitude.

    Attributes:
        kind: a key of `FAULT_KINDS`.
        target: one of that kind's targets.
        onset, end: active in ticks onset <= k < end; for a continuous component, in the steps that begin there.
        magnitude: SI (rad, m, s, a share, a factor); 0 for a kind without one.
        share: share of an encoder's samples hit by a glitch, 0..1.
        ramp: number of ticks over which a parameter fault grows from zero to its magnitude; 0 for a step.
        seed: seed of random kinds; equal seeds give equal faults.
        table: number of its [[fault]] table, from 1; 0 without one. Members of a group share it, and their random
            numbers.
    """

    kind: str
    target: str
    onset: int
    end: int = NO_END_TICK
    magnitude: float = 0.0
    share: float = 0.0
    ramp: int = 0
    seed: int = 0
    table: int = field(default=0, compare=False)


class FaultTable(Settings):
    """Keys common to all kinds; without `duration_s` a fault is permanent, without `target` it hits the first one."""

    kind: str = setting(help="kind of fault")
    target: str | None = setting(default=None, help="target; without it, the first target of the kind")
    onset: float = setting("s", ge=0, help="time of the onset; a whole number of ticks")
    duration: float | None = optional("s", gt=0, example=2.0, help="duration; without it, to the end of the run")
    seed: int = setting(default=0, ge=0, lt=2**63, help="seed of the random numbers, for random kinds")


@cache
def fault_table_model(known: FaultKind) -> type[FaultTable]:
    """Return the pydantic model of the [[fault]] table of one kind of fault."""
    own: dict[str, Any] = {}
    if known.magnitude_key:
        own["magnitude"] = (float, setting(known.unit or "", help="magnitude", **dict[str, Any](known.bounds)))
    if known.has_share:
        # more than every second sample would no longer be single ones
        own["share"] = (float, setting(gt=0, le=0.5, help="share of affected samples"))
    if known.mechanism == "parameter":
        own["ramp"] = (
            float | None,
            setting("s", default=None, gt=0, help="time of the growth from zero to the magnitude"),
        )
    return create_model("FaultTable", __base__=FaultTable, __doc__=known.meaning, **own)


def checked_faults(tables: Any, tick: float, mistakes: list[str]) -> tuple[Fault, ...]:
    """Check the [[fault]] tables of an experiment; return the valid faults in SI and whole ticks, one per group member.

    `tables` is the array from the file, () if missing; `tick` is in s.
    """
    faults: list[Fault] = []
    for number, table in numbered_tables(tables, "fault", mistakes):
        found: list[str] = []
        fault = _check_fault(number, table, tick, found)
        mistakes += found
        if fault is not None and not found:
            faults += member_faults(fault)
    return tuple(faults)


def member_faults(fault: Fault) -> list[Fault]:
    """Split a fault of a target group into one fault per member; a fault of a single target stays as it is."""
    return [replace(fault, target=target) for target in FAULT_KINDS[fault.kind].members(fault.target)]


def _check_fault(number: int, table: Any, tick: float, mistakes: list[str]) -> Fault | None:
    if not isinstance(table, dict):
        mistakes.append(f"[[fault]] {number} = {table!r}: expected a table")
        return None
    name = table.get("kind")
    try:
        known = find_kind(number, name if isinstance(name, str) else str(name))
        refuse_target(number, str(name), str(table.get("target", known.targets[0])))
    except InputRefused as problem:
        mistakes.append(str(problem))
        if str(problem).startswith(f"[[fault]] {number} kind"):
            return None
    model = fault_table_model(known)
    wrong = [key for key in table if key.startswith("magnitude") and key != known.magnitude_key]
    mistakes += [f"[[fault]] {number} {key}: {name} takes {known.magnitude_key or 'no magnitude'}" for key in wrong]
    found: list[str] = []
    values = check_table(model, {key: value for key, value in table.items() if key not in wrong}, "[fault]", found)
    instead = f"missing key '{known.magnitude_key}'"
    mistakes += [
        text.replace("[[fault]]", f"[[fault]] {number}", 1) for text in found if not (wrong and text.endswith(instead))
    ]
    return None if values is None else _in_ticks(number, known, values.model_dump(), tick, mistakes)


def _in_ticks(number: int, known: FaultKind, values: Mapping[str, Any], tick: float, mistakes: list[str]) -> Fault:
    lengths = {"onset_s": values["onset"], "duration_s": values["duration"], "ramp_s": values.get("ramp")}
    if known.unit == "ms":
        lengths["magnitude_ms"] = values["magnitude"]
    ticks = {}
    for key, length in lengths.items():
        ticks[key] = whole_ticks(length or 0.0, tick) or 0
        if length and whole_ticks(length, tick) is None:
            mistakes.append(f"[[fault]] {number} {key}: {length:g} s is not a whole number of ticks of {tick:g} s")
    return Fault(
        kind=values["kind"],
        target=values["target"] or known.targets[0],
        onset=ticks["onset_s"],
        end=NO_END_TICK if values["duration"] is None else ticks["onset_s"] + ticks["duration_s"],
        magnitude=values.get("magnitude", 0.0),
        share=values.get("share", 0.0),
        ramp=ticks["ramp_s"],
        seed=values["seed"],
        table=number,
    )
