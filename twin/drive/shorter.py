"""A step that came back discarded (FMI 1.0 and 2.0): go on from the last successful time, in shorter steps.

A slave that discards has computed a part of the step, perhaps none (FMI 2.0.4, 4.2.2). It is asked how far it got and
stepped from there, over what it has shown that it can do, over half of the step if it has shown nothing, and over
longer parts again as long as that goes well.
"""

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.drive.calls import ask_status, do_step_2
from twin.drive.ramp import set_ramp
from twin.drive.status import (
    DISCARD,
    DO_STEP,
    MOST_STEPS,
    OUTSIDE,
    SHORTENED,
    STUCK,
    TERMINATE,
    TOO_MANY,
)

SHORTER = np.dtype(
    [
        ("real_status", "i8"),
        ("boolean_status", "i8"),
        ("value", "f8"),
        ("flag", "i8"),
        ("value_at", "i8"),
        ("flag_at", "i8"),
        ("varies", "i8"),
        ("discarded", "i8"),
        ("since", "f8"),
    ],
    align=True,
)
"""Addresses of fmiNGetRealStatus and fmiNGetBooleanStatus (0 in FMI 1.0), what they return and where; whether the FMU
takes steps of varying size; how many steps it has discarded, and when the first."""

LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3
"""fmi2StatusKind, and fmiStatusKind for the first."""

_shorter_at = pointer_to(SHORTER)


@njit(cache=True)
def _reached(s, instance, here, goal, close):
    """(time that the FMU has reached, 0), or (NaN, status) if the run ends with that."""
    s.flag, s.value = 0, np.nan
    if s.boolean_status != 0 and ask_status(s.boolean_status, instance, TERMINATED, s.flag_at) <= 1 and s.flag != 0:
        return np.nan, TERMINATE
    if ask_status(s.real_status, instance, LAST_SUCCESSFUL_TIME, s.value_at) > 1 or s.varies == 0:
        return np.nan, DO_STEP + DISCARD
    if not (here - close <= s.value <= goal + close):
        return np.nan, OUTSIDE
    return s.value, 0


@njit(cache=True)
def go_on(address, ramp, do_step, instance, t, h, final):
    """Come to `t` + `h` after the step from `t` was discarded; 0, or the status that ends the run.

    Args:
        address: of a `SHORTER`.
        ramp: of a `RAMP` whose inputs are set anew for each part; 0: the inputs are held.
    """
    s = carray(_shorter_at(address), 1)[0]
    close = 1e-9 * h
    here, end, part, halved = t, t + h, h, 0
    status = DISCARD
    if s.discarded == 0:
        s.since = t
    for _ in range(MOST_STEPS):
        if status == DISCARD:
            s.discarded += 1
            reached, bad = _reached(s, instance, here, here + part, close)
            if bad != 0:
                return bad
            if reached > here + close:
                part, here, halved = reached - here, reached, 0
            else:
                part, halved = 0.5 * part, halved + 1
                if halved > SHORTENED:
                    s.value = here
                    return STUCK
        elif status > 1:
            return DO_STEP + status
        else:
            here, part, halved = here + part, 2.0 * part, 0
        if end - here <= close:
            return 0
        part = min(part, end - here)
        if ramp != 0:
            bad = set_ramp(ramp, here)
            if bad != 0:
                return bad
        status = do_step_2(do_step, instance, here, part, final)
    s.value = here
    return TOO_MANY
