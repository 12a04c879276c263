"""Clocks of FMI 3.0 (2.2.8): when those that we have to tick do so, in whole steps of the drive."""

import math
from ctypes import c_double, c_int, c_uint
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.drive.events import CHANGING, CLOCK, COUNTDOWN, NEVER, OUTPUT, PERIODIC
from twin.drive.variable import number
from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.drive.description import FmuDescription
    from twin.drive.instance import Instance

MOST_CLOCKS = 62
"""A bit of a number tells of each whether it is active."""

NOT_YET_KNOWN = 0
"""fmi3IntervalNotYetKnown."""


def clocks(description: "FmuDescription") -> list[Any]:
    """FMPy's variables of its clocks, those that we tick and those that it ticks.

    Raises:
        InputRefused: there are too many.
    """
    found = [v for v in description.model.modelVariables if v.type == "Clock" and v.causality in ("input", "output")]
    if len(found) > MOST_CLOCKS:
        raise InputRefused(f"{description.path}: {len(found)} clocks; expected at most {MOST_CLOCKS}")
    return found


def rhythm(clock: Any) -> str:
    """When a clock ticks, as its description says it."""
    if clock.causality == "output":
        return "ticked by the FMU"
    if clock.intervalVariability == "triggered":
        return "in every step"
    interval, shift = _stated(clock)
    if math.isnan(interval):
        return f"{clock.intervalVariability}, as the FMU says while it runs"
    return f"every {1e3 * interval:g} ms" + (f" from {1e3 * shift:g} ms on" if shift else "")


def clock_table(instance: "Instance") -> np.ndarray:
    """The clocks of an instance in initialisation mode, (clocks,) of `events.CLOCK`.

    Raises:
        InputRefused: a clock does not tick in whole steps.
    """
    found = clocks(instance.description)
    table = np.zeros(len(found), dtype=CLOCK)
    for row, clock in zip(table, found, strict=True):
        row["reference"], row["kind"], row["next"] = clock.valueReference, PERIODIC, NEVER
        if clock.causality == "output":
            row["kind"] = OUTPUT
        elif clock.intervalVariability == "triggered":
            row["period"], row["next"] = 1, 0
        elif clock.intervalVariability in ("changing", "countdown"):
            row["kind"] = CHANGING if clock.intervalVariability == "changing" else COUNTDOWN
            interval, known = _asked(instance, clock)
            row["next"] = _steps(instance, clock, interval, 1) if known else NEVER
        else:
            interval, shift = _stated(clock)
            if clock.intervalDecimal is None and clock.intervalCounter is None:
                interval, shift = _asked(instance, clock)[0], _asked_shift(instance, clock)
            elif clock.intervalVariability != "constant":
                instance.fmu.setIntervalDecimal((c_uint * 1)(clock.valueReference), (c_double * 1)(interval))
            row["period"] = _steps(instance, clock, interval, 1)
            row["next"] = _steps(instance, clock, shift, 0)
    return table


def _stated(clock: Any) -> tuple[float, float]:
    """(interval, shift) in seconds, as the description states them; NaN: it states no interval."""
    resolution = number(clock.resolution)
    if clock.intervalDecimal is not None or math.isnan(resolution):
        return number(clock.intervalDecimal), number(clock.shiftDecimal or "0")
    scale = 1.0 / resolution if resolution > 0.0 else math.nan
    return number(clock.intervalCounter) * scale, number(clock.shiftCounter or "0") * scale


def _asked(instance: "Instance", clock: Any) -> tuple[float, bool]:
    """(interval, whether it is known) of a clock, by the FMU's own word."""
    interval, qualifier = (c_double * 1)(math.nan), (c_int * 1)(NOT_YET_KNOWN)
    instance.fmu.getIntervalDecimal((c_uint * 1)(clock.valueReference), interval, qualifier)
    return interval[0], qualifier[0] != NOT_YET_KNOWN


def _asked_shift(instance: "Instance", clock: Any) -> float:
    shift = (c_double * 1)(0.0)
    instance.fmu.getShiftDecimal((c_uint * 1)(clock.valueReference), shift)
    return shift[0]


def _steps(instance: "Instance", clock: Any, interval: float, least: int) -> int:
    """`interval` (s) in whole steps of the instance, at least `least`."""
    step = instance.setup.step or math.nan
    count = interval / step
    # a thousandth of a step would add up to a step within a second
    if not (count < 1e9 and round(count) >= least and abs(count - round(count)) < 1e-6):
        raise InputRefused(
            f"clock '{clock.name}' has an interval or shift of {1e3 * interval:g} ms; the drive's step is "
            f"{1e3 * step:g} ms, and its clocks tick in whole steps: choose a tick or substeps that fit"
        )
    return round(count)
