"""One compiled step for FMI 3.0 FMUs that have an event mode, may return early, or do something within a step.

A step is a loop: step as far as the tick's end or the next planned event, and handle what came up there, until the
tick's end is reached. An FMU for which nothing comes up makes one turn of it.
"""

import numpy as np

from twin.compiled.function import carray, njit
from twin.cosim.native import address_of, bytes_at, doubles_at, step_function
from twin.drive.adapter import drain, get_all, groups_at, set_all
from twin.drive.calls import do_step_3
from twin.drive.events import inputs_change, pass_events, tick_due
from twin.drive.ramp import bad_ramp, begin_ramp, set_ramp
from twin.drive.status import (
    DISCARD,
    DO_STEP,
    EARLY,
    MOST_STALLS,
    MOST_STEPS,
    OUTSIDE,
    SHORTENED,
    STALLED,
    STUCK,
    TERMINATE,
    TOO_MANY,
)

MEMORY = np.dtype(
    [
        ("instance", "i8"),
        ("do_step", "i8"),
        ("final", "i8"),
        ("inputs", "i8"),
        ("input_groups", "i8"),
        ("outputs", "i8"),
        ("output_groups", "i8"),
        ("held", "i8"),
        ("held_groups", "i8"),
        ("returned", "i8"),
        ("ramp", "i8"),
        ("events", "i8"),
        ("next", "i8"),
        ("clocks", "i8"),
        ("discrete", "i8"),
        ("early", "i8"),
        ("varies", "i8"),
        ("value", "f8"),
    ],
    align=True,
)
"""Addresses and counts as in `adapter`; clocked outputs, `held`, are read in events. Addresses of a `RAMP`, of an
`EVENTS` (0: none) and of the time of the next event; how many clocks and groups of discrete inputs there are; whether
the FMU may return early, and takes steps of varying size; the time it told when it went wrong."""


@njit(cache=True, inline="always")
def _set_off(m, t, h, u):
    """Everything before the first call of doStep."""
    if m.events != 0:
        n = tick_due(m.events, t, h) if m.clocks > 0 else -1
        changed = m.discrete > 0 and inputs_change(m.events, u)
        if n >= 0 or changed or carray(doubles_at(m.next), 1)[0] <= t + 1e-9 * h:
            status = pass_events(m.events, n, t)
            if status != 0:
                return status
    status = set_all(3, m.instance, m.input_groups, m.inputs, u)
    if status == 0 and m.ramp != 0:
        begin_ramp(m.ramp, u, t, h)
        status = set_ramp(m.ramp, t)
    return status


@njit(cache=True, inline="always")
def _come_to(m, t, h):
    """From `t` to `t` + `h`; 0, or the status that ends the run."""
    close, here, end = 1e-9 * h, t, t + h
    part, halved, stalls = h, 0, 0
    flags, last = carray(bytes_at(m.returned), 16), carray(doubles_at(m.returned), 1)
    planned = carray(doubles_at(m.next), 1)
    for _ in range(MOST_STEPS):
        goal = end
        if m.varies:
            if here + close < planned[0] < end - close:
                goal = planned[0]
            if goal - here > part:
                goal = here + part
        for i in range(8, 11):
            flags[i] = 0
        status = do_step_3(m.do_step, m.instance, here, goal - here, m.final, m.returned)
        if m.ramp != 0:
            bad = bad_ramp(m.ramp)
            if bad != 0:
                return bad
        if status == DISCARD and m.varies:
            # the FMU is where it was before
            part, halved, m.value = 0.5 * (goal - here), halved + 1, here
            if halved > SHORTENED:
                return STUCK
            continue
        if status > 1:
            return DO_STEP + status
        if flags[9]:
            return TERMINATE
        reached = goal
        if flags[10]:
            if not m.early:
                return EARLY
            m.value = reached = last[0]
            if not (here - close <= reached <= goal + close):
                return OUTSIDE
        part, halved = max(2.0 * part, reached - here), 0
        stalls = stalls + 1 if reached <= here + close else 0
        if stalls > MOST_STALLS:
            m.value = here
            return STALLED
        here = max(reached, here)
        if m.events != 0 and (flags[8] or planned[0] <= here + close):
            status = pass_events(m.events, -1, here)
            if status != 0:
                return status
        if end - here <= close:
            return 0
        if m.ramp != 0:
            status = set_ramp(m.ramp, here)
            if status != 0:
                return status
    m.value = here
    return TOO_MANY


@njit(cache=True, inline="always")
def _outputs(m, y):
    held = carray(groups_at(m.held_groups), m.held)
    for i in range(m.held):
        drain(held[i], address_of(y))
    return get_all(3, m.instance, m.output_groups, m.outputs, address_of(y))


@step_function(MEMORY)
def step(m, t, h, u, y):
    status = _set_off(m, t, h, address_of(u))
    if status != 0:
        return status
    status = _come_to(m, t, h)
    return _outputs(m, y) if status == 0 else status
