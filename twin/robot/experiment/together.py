"""Simultaneous faults: common causes, and pairs of kinds.

A common cause breaks several parts at once: three drives on one bus or driver board, encoders on one supply, springs of
one batch. A pair consists of two faults of different components with the same onset, one kind per component.
"""

import re
from itertools import combinations, permutations
from typing import Any, NamedTuple

from twin.kernel.errors import InputRefused
from twin.robot.experiment.fault import (
    ALWAYS_DETECTED,
    FAULT_KINDS,
    NEVER_DETECTED,
    DetectionThreshold,
    expected_names,
)

_BOARD_CAUSE, _SUPPLY_CAUSE, _BATCH_CAUSE = "one bus or driver board", "one supply or cable", "one batch or one repair"
EQUIVALENT_FAULTS = {
    ("controller", "bus"): "drives cannot distinguish the two sources of a repeated command",
    ("motor encoder", "messages"): "missing messages cannot be wrong",
    ("joint encoder", "messages"): "missing messages cannot be wrong",
}
"""Pairs that are equivalent to a single fault."""
RUNAWAY_KIND = "drive_runaway"
GROUP_SEPARATOR, PAIR_SEPARATOR, SEQUENCE_SEPARATOR = "@", "+", "-then-"
"""Separators in names of fault sets: `drive_runaway@all_drives`, `drive_runaway+sample_loss`, and
`sample_loss-then-drive_runaway`, whose second fault begins after the trip caused by the first."""
ALL_PREFIX, EACH_PREFIX = "all ", "each "
"""Prefixes of a group's name: all members with one magnitude, or each with its own magnitude and sign."""
AXES = 3


class CommonCause(NamedTuple):
    """A common cause that breaks several parts of the robot at once, as a fault of a target group.

    Attributes:
        target: one of the kind's groups, or a target shared by all parts.
        why: plausible physical cause.
        threshold: smallest magnitude that the monitor is expected to detect, stated before any run.
    """

    kind: str
    target: str
    why: str
    threshold: DetectionThreshold


COMMON_CAUSES = (
    CommonCause("drive_runaway", "all drives", _BOARD_CAUSE, ALWAYS_DETECTED),
    CommonCause("drive_freewheel", "all drives", _SUPPLY_CAUSE, ALWAYS_DETECTED),
    CommonCause("drive_dead", "all drives", _SUPPLY_CAUSE, ALWAYS_DETECTED),
    CommonCause("drive_saturation", "all drives", _BOARD_CAUSE, DetectionThreshold(0.3, 0.05)),
    CommonCause("encoder_bias", "all joint encoders", _BATCH_CAUSE, DetectionThreshold(2.0, 2.0)),
    CommonCause("encoder_drift", "all joint encoders", _SUPPLY_CAUSE, DetectionThreshold(2.0, 2.0)),
    CommonCause("encoder_drift", "all motor encoders", _SUPPLY_CAUSE, DetectionThreshold(2.0, 2.0)),
    CommonCause("encoder_quantisation", "all encoders", _SUPPLY_CAUSE, DetectionThreshold(2.0, 2.0)),
    CommonCause("encoder_dropout_hold", "all encoders", _SUPPLY_CAUSE, DetectionThreshold(1.0, 1.0)),
    CommonCause("encoder_dropout_zero", "all encoders", _SUPPLY_CAUSE, ALWAYS_DETECTED),
    CommonCause("encoder_dropout_nan", "all encoders", _SUPPLY_CAUSE, ALWAYS_DETECTED),
    CommonCause("encoder_stuck", "all encoders", _SUPPLY_CAUSE, ALWAYS_DETECTED),
    CommonCause("encoder_glitch", "all encoders", _SUPPLY_CAUSE, DetectionThreshold(5.0, 5.0)),
    CommonCause("spring_softened", "all joints", _BATCH_CAUSE, NEVER_DETECTED),
    CommonCause("spring_broken", "all joints", _BATCH_CAUSE, ALWAYS_DETECTED),
    CommonCause("backlash_growth", "all joints", _BATCH_CAUSE, NEVER_DETECTED),
    CommonCause("joint_friction", "all joints", _BATCH_CAUSE, NEVER_DETECTED),
    CommonCause("belt_slip", "all joints", _BATCH_CAUSE, DetectionThreshold(-10.0, -30.0)),
    CommonCause("command_held", "bus", _BOARD_CAUSE, DetectionThreshold(1.0, None)),
    CommonCause("command_lost", "bus", _BOARD_CAUSE, NEVER_DETECTED),
    CommonCause(
        "command_held",
        "controller",
        "the controller stops, its last command is repeated",
        DetectionThreshold(1.0, None),
    ),
    CommonCause("command_lost", "controller", "the controller stops", NEVER_DETECTED),
    CommonCause("brown_out", "power", _SUPPLY_CAUSE, DetectionThreshold(0.05, 0.05)),
    CommonCause("power_off", "power", _SUPPLY_CAUSE, ALWAYS_DETECTED),
)
"""Common causes; tests/robot/experiment/test_together.py lists the kinds omitted here and in `PAIR_PARTS`, with
reasons."""


class PairPart(NamedTuple):
    """A component of the robot, with the fault that represents it in pairs of faults."""

    component: str
    kind: str
    target: str
    magnitude: float | None


PAIR_PARTS = (
    PairPart("joint encoder", "encoder_drift", "joint_encoder_1", 2.0),
    PairPart("motor encoder", "encoder_stuck", "motor_encoder_1", None),
    PairPart("messages", "sample_loss", "encoder", 1.0),
    PairPart("estimator", "belief_eta", "estimator", 0.7),
    PairPart("controller", "command_held", "controller", 1.0),
    PairPart("bus", "command_held", "bus", 1.0),
    PairPart("spring", "spring_softened", "joint_1", 0.4),
    PairPart("belt", "belt_slip", "joint_1", -10.0),
    PairPart("drive", "drive_runaway", "drive_1", 8.0),
    PairPart("power", "brown_out", "power", 0.01),
    PairPart("body", "surface_jump", "contact", 5.0),
)
"""Per component, the kind that is hidden best from the monitor or presses most before it is detected."""

FAULT_PAIRS = tuple(
    (one, other)
    for one, other in combinations(PAIR_PARTS, 2)
    if (one.component, other.component) not in EQUIVALENT_FAULTS
)


ALL_DRIVES = PairPart("drives", RUNAWAY_KIND, "all drives", 4.0)
"""A second fault that presses harder than one drive."""
ORDERED_PAIRS = tuple(both for pair in FAULT_PAIRS for both in permutations(pair))
ORDERED_PAIRS += tuple((first, ALL_DRIVES) for first, second in ORDERED_PAIRS if second.kind == RUNAWAY_KIND)
"""Every pair in both orders; where a drive runs away second, all drives do, too."""


def expects_detection(cause: CommonCause, magnitude: float | None, in_contact: bool) -> bool:
    """Whether the safety monitor is expected to detect a common cause at a magnitude of the catalogue."""
    start = cause.threshold.contact if in_contact else cause.threshold.free
    return FAULT_KINDS[cause.kind].is_reached(start, magnitude)


def fault_values(kind: str, target: str, magnitude: float | None, onset: float) -> dict[str, Any]:
    """Return the [[fault]] table of one fault with its onset (s)."""
    key = FAULT_KINDS[kind].magnitude_key
    return {"kind": kind, "target": target, "onset_s": onset} | ({key: magnitude} if key else {})


class SetPart(NamedTuple):
    """One fault of a set of simultaneous faults: its kind and possible targets."""

    kind: str
    targets: tuple[str, ...]


def parse_fault_set(name: str) -> tuple[SetPart, ...]:
    """Parse the name of a set of faults: one kind, a kind with a target group, or several kinds.

    `drive_runaway@each_drive` is three faults, of the group `all drives`.

    Raises:
        InputRefused: the kind or group is unknown.
    """
    parts = []
    for text in re.split(f"{re.escape(PAIR_SEPARATOR)}|{SEQUENCE_SEPARATOR}", name):
        kind, of, group = text.partition(GROUP_SEPARATOR)
        if kind not in FAULT_KINDS:
            raise InputRefused(f"--kind {name}: {expected_names(kind, tuple(FAULT_KINDS))}")
        known = FAULT_KINDS[kind]
        each = {_each_group_name(one): known.members(one) for one in known.groups if one.startswith(ALL_PREFIX)}
        whole = {one.replace(" ", "_"): (one,) for one in known.groups} | {one: (one,) for one in known.targets}
        if of and group not in each | whole:
            there = ", ".join([*(one.replace(" ", "_") for one in known.groups), *each]) or "none"
            raise InputRefused(f"--kind {name}: no group '{group}' of {kind}; there are {there}")
        if group in each:
            parts += [SetPart(kind, (member,)) for member in each[group]]
        else:
            parts.append(SetPart(kind, whole[group] if of else known.targets))
    return tuple(parts)


def _each_group_name(group: str) -> str:
    """Convert a target group `all drives` to `each_drive`, the name of one fault per member."""
    return (EACH_PREFIX + group.removeprefix(ALL_PREFIX).removesuffix("s")).replace(" ", "_")


def common_names() -> tuple[str, ...]:
    """Return the fault-set names of all common causes that hit a target group.

    Signed ones also have a name with a magnitude for each axis.
    """
    names = []
    for cause in COMMON_CAUSES:
        known = FAULT_KINDS[cause.kind]
        if cause.target in known.groups:
            names.append(f"{cause.kind}{GROUP_SEPARATOR}{cause.target.replace(' ', '_')}")
            signed = known.magnitudes is not None and not {"gt", "ge"} & known.bounds.keys()
            if signed and len(known.members(cause.target)) == AXES:
                names.append(f"{cause.kind}{GROUP_SEPARATOR}{_each_group_name(cause.target)}")
    return tuple(names)


def pair_names() -> tuple[str, ...]:
    """Return the fault-set names of all pairs of faults; a kind is followed by its target where that is ambiguous."""
    return tuple(dict.fromkeys(PAIR_SEPARATOR.join(_pair_part_name(part) for part in pair) for pair in FAULT_PAIRS))


def ordered_names() -> tuple[str, ...]:
    """Return the fault-set names of pairs whose second fault begins after the first has tripped the monitor.

    Each pair is listed in both orders.
    """
    return tuple(
        dict.fromkeys(SEQUENCE_SEPARATOR.join(_pair_part_name(part) for part in pair) for pair in ORDERED_PAIRS)
    )


def _pair_part_name(part: PairPart) -> str:
    known = FAULT_KINDS[part.kind]
    group = part.target in known.groups and part.target not in known.targets
    one_place = group or known.targets == ("controller", "bus")
    return f"{part.kind}{GROUP_SEPARATOR}{part.target.replace(' ', '_')}" if one_place else part.kind
