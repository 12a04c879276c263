"""[[change]]: scheduled changes of controller parameters, such as a step of the force reference."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings, setting
from twin.robot.experiment.mistakes import checked, numbered, unknown
from twin.robot.experiment.schema import Declared, whole_ticks
from twin.robot.experiment.source import at

FORCE_LOOP = "controller.force."
"""Where the keys of the force loop begin."""
SCHEDULED = ("controller.force.kp_mm_per_N", "controller.force.ki_mm_per_N_s")
"""What may not, where [controller.force] has a schedule of them."""


class ChangeTable(Settings):
    """[[change]]: a value of [controller] that changes while the experiment runs."""

    t: float = setting("s", gt=0, examples=[8.0], help="when it changes")
    key: str = setting(examples=["controller.force.reference_N"], help="what changes")
    value: float = setting(examples=[6.0], help="its new value, in the unit of the key")


@dataclass(frozen=True)
class Change:
    """A [[change]], checked.

    Attributes:
        tick: from which on it holds.
        key: of the experiment's file.
        number: in the unit of the key.
        value: in SI.
    """

    tick: int
    key: str
    number: float
    value: float


def changeable(declared: Declared, tables: Mapping[str, Any]) -> dict[str, float]:
    """What may change in an experiment, with the value in its file, in the unit of the key.

    Nothing of the force loop where it never acts, and no reference where tasks bring their own.

    Args:
        declared: what may be said in them.
        tables: of the experiment, as `Experiment.values`.
    """
    found = {}
    for key in declared.changeable:
        number = at(tables, key)
        acts = not key.startswith(FORCE_LOOP) or at(tables, "controller.mode") == "force_position"
        # a schedule sets these itself
        acts = acts and not (at(tables, "controller.force.schedule") and key in SCHEDULED)
        if acts and number is not None:
            found[key] = number
    return found


def changed_value(declared: Declared, key: str, number: object, tables: Mapping[str, Any]) -> float:
    """`number`, given in the unit of the `key`, in SI.

    Args:
        declared: has `key` among what is changeable.
        number: whatever somebody has sent.
        tables: of the experiment, as `Experiment.values`.

    Raises:
        InputRefused: the experiment's schema refuses it.
    """
    if number is None:
        # the file may leave the reference out where no force loop acts; a running one needs it
        raise InputRefused(f"{key}: no value; expected a number")
    table, attribute = declared.changeable[key]
    path, _, name = key.rpartition(".")
    mistakes: list[str] = []
    changed = checked(table, {**at(tables, path), name: number}, path, mistakes)
    if mistakes:
        raise InputRefused("; ".join(mistakes))
    return getattr(changed, attribute)


def checked_changes(
    declared: Declared, tables: Any, values: Mapping[str, Any], tick: float, duration: float, mistakes: list[str]
) -> tuple[Change, ...]:
    """The changes of the array of tables [[change]] that are right, the earliest first.

    Args:
        declared: what may be said in the tables.
        tables: what the file says; () if nothing.
        values: the tables of the experiment.
        tick, duration: s.
        mistakes: gets a sentence for each mistake, with the number of its change, counted from 1.
    """
    changes: dict[tuple[int, str], Change] = {}
    for number, table in numbered(tables, "change", mistakes):
        wanted = checked(ChangeTable, table, f"change {number}", mistakes)
        if wanted is None:
            continue
        try:
            change = _checked(declared, wanted, values, tick, duration)
        except InputRefused as problem:
            mistakes.append(f"[change {number}] {problem}")
            continue
        if (change.tick, change.key) in changes:
            mistakes.append(f"[change {number}] changes {change.key} at {wanted.t:g} s a second time; remove one")
        changes[change.tick, change.key] = change
    return tuple(changes[place] for place in sorted(changes))


def _checked(
    declared: Declared, wanted: ChangeTable, values: Mapping[str, Any], tick: float, duration: float
) -> Change:
    known = changeable(declared, values)
    if wanted.key in declared.changeable and wanted.key not in known:
        raise InputRefused(f'key = "{wanted.key}": does not act in this experiment; known are {", ".join(known)}')
    if wanted.key not in known:
        raise InputRefused(f"key: {unknown(wanted.key, list(known))}")
    if wanted.t > duration:
        raise InputRefused(f"t_s = {wanted.t:g}: after the end at {duration:g} s")
    at = whole_ticks(wanted.t, tick)
    if at is None:
        raise InputRefused(f"t_s = {wanted.t:g}: not a whole number of ticks of {tick:g} s")
    return Change(at, wanted.key, wanted.value, changed_value(declared, wanted.key, wanted.value, values))
