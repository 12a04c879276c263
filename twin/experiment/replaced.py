"""Tables of an experiment that name something altogether: what files below said of another one is forgotten."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

SHAPES = ("circle", "chirp", "joint_step")
"""Tables of [reference], each of which says by itself all that the reference is."""


def names_drive(table: Mapping[str, Any]) -> bool:
    """Whether a table of a drive says which one: by its FMU, or those of its parts; else it lays values over one."""
    parts = table.get("parts")
    named = parts.values() if isinstance(parts, Mapping) else ()
    return "fmu" in table or any(isinstance(part, Mapping) and "fmu" in part for part in named)


def _has(*keys: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda table: any(key in table for key in keys)


KEPT = {
    "body": (),
    "estimator": (),
    "controller": (
        "period_ms", "delay_ticks", "bus_delay_ticks", "speed_limit_rad_per_s", "gravity_compensation", "dead_zone_deg",
        "energy_tank", "model",
    ),
    "monitor": ("enabled", "period_ms"),
    "scale": ("period_ms",),
}  # fmt: skip
"""Parts of the robot that may be of another make, and the keys of their tables that act all the same."""


NAMING = ("fmu", "python")
"""Keys whose value is a file; of a class behind a colon, too."""


def names_stand_in(table: Mapping[str, Any]) -> bool:
    """Whether a table of a part says that it is of another make."""
    return any(key in table for key in NAMING)


class Rule(NamedTuple):
    """A table that names something altogether takes the place of what was said of another one.

    Attributes:
        names: whether it does so, by its keys.
        kept: keys of the table before that stay; None: none, nor the table's place among the others.
        by_key: whether a single key of it on the command line does so, too.
    """

    names: Callable[[Mapping[str, Any]], bool]
    kept: tuple[str, ...] | None
    by_key: bool = False


RULES: dict[str, tuple[Rule, ...]] = {
    "drive": (Rule(names_drive, None),),
    "contact": (Rule(_has("body"), None),),
    # of way points one file may give the times and another the places
    "reference": (Rule(_has(*SHAPES), ()), Rule(_has("t_s", "p_mm"), ("t_s", "p_mm"))),
    **{role: (Rule(names_stand_in, kept, by_key=True),) for role, kept in KEPT.items()},
}


def rules_for(name: str, table: Any, by_key: bool = False) -> list[Rule]:
    """By which rules `table`, called `name`, takes another one's place; `by_key`: it is a key of the command line."""
    rules = RULES.get(name, ()) if isinstance(table, Mapping) else ()
    return [rule for rule in rules if rule.names(table) and (rule.by_key or not by_key)]
