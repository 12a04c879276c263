"""Values that look as if they were meant in another unit, for experiments in which the robot gets nowhere."""

from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

LENGTHS = ("a_mm", "b_mm", "l_a_mm", "l_b_mm")
ROBOTS = ("robot", "plant", "controller.model")
LEAST, MOST = 1.0, 5000.0
"""Lengths (mm) between which a robot for a person's back has its own, and its way points their height."""


def unit_hints(values: Mapping[str, Any]) -> list[str]:
    """A sentence for each length that would be plausible were it in m, or in um, rather than in mm.

    Args:
        values: of an experiment, as `Experiment.values`, checked or not.
    """
    told: dict[str, str] = {}
    for key, length in _lengths(values):
        factor = 1e3 if abs(length) < LEAST else 1e-3
        plausible = LEAST <= abs(length) * factor <= MOST
        if length and not LEAST <= abs(length) <= MOST and plausible:
            # [plant] and [controller.model] have it from [robot]: told once
            told.setdefault(
                key.rpartition(" ")[2] + f"{length:g}",
                f"{key} = {length:g}: {length:g} mm; did you mean {length * factor:g} (mm)?",
            )
    return list(told.values())


def _lengths(values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name in ROBOTS:
        table = _table(values, name)
        yield from ((f"[{name}] {key}", table[key]) for key in LENGTHS if _is_number(table.get(key)))
    points = _table(values, "reference").get("p_mm")
    if isinstance(points, tuple) and all(isinstance(p, tuple) and len(p) == 3 for p in points):
        # the height of all of them tells: x and y may well be zero
        heights = [p[2] for p in points if _is_number(p[2])]
        if heights:
            yield "[reference] p_mm, z of the lowest", min(heights)
    for name, key in (("contact", "height_mm"), ("approach", "height_mm")):
        height = _table(values, name).get(key)
        if _is_number(height):
            yield f"[{name}] {key}", height


def _table(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found: Any = values
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found if isinstance(found, Mapping) else {}


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
