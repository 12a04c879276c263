"""The equations of a model-exchange FMU by address: memory, derivatives, event indicators, events, failures.

Events are inputs that jump, times that the FMU asked for, indicators that change sign, and steps after which it wants
one (FMI 2.0.4, 3.2.2; FMI 3.0, 3.2).
"""

from typing import Any

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import doubles_at
from twin.kernel.fmi.groups import (
    MOST_UPDATES,
    STATUSES,
    TERMINATE,
    at_time,
    completed_2,
    completed_3,
    on_doubles,
    on_pointer,
    plain,
    set_all,
    start_at,
    update_3,
)

FUNCTIONS = {
    "set_time": "SetTime",
    "set_states": "SetContinuousStates",
    "states_of": "GetContinuousStates",
    "nominals_of": "GetNominalsOfContinuousStates",
    "derivatives_of": "GetDerivatives",
    "indicators_of": "GetEventIndicators",
    "enter_event_mode": "EnterEventMode",
    "update": "NewDiscreteStates",
    "enter_time_mode": "EnterContinuousTimeMode",
    "completed": "CompletedIntegratorStep",
    "number_of_states": "GetNumberOfContinuousStates",
}
"""Those of the FMU, by field of `MEMORY`, as FMI 2.0 calls them, which does not have the last."""
FUNCTIONS_3 = FUNCTIONS | {"derivatives_of": "GetContinuousStateDerivatives", "update": "UpdateDiscreteStates"}
"""As FMI 3.0 does."""
_SOLVER = ("cvode", "vector", "absolute", "cv_step", "cv_restart", "cv_stop", "cv_tolerances", "cv_values")
_ARRAYS = ("x", "began", "k_1", "k_2", "k_3", "k_4", "z", "z_before", "scales", "info", "last_inputs", "reached_at")
_COUNTS = ("version", "instance", "states", "size", "indicators", "width", "needs_completed", "final")
_PORTS = ("inputs", "input_groups", "outputs", "output_groups")
_MOVING = ("fresh", "restart", "trouble", "element", "flag")

MEMORY = np.dtype(
    [(name, "i8") for name in (*FUNCTIONS, *_SOLVER, *_ARRAYS, *_COUNTS, *_PORTS, *_MOVING)]
    + [(name, "f8") for name in ("tolerance", "longest", "now", "reached", "next_event", "asked")],
    align=True,
)
"""Addresses of the FMU's functions, of CVODE's (`cvode` 0: Runge-Kutta) and of arrays; numbers of things; and

    fresh: 1: no call has reached the FMU yet.
    restart: 1: the solver has to begin anew.
    trouble: status of the first thing that went wrong in a call that the solver made.
    element, flag, asked: which state, which return value of CVODE, which time, for the sentence.
    tolerance: relative.
    longest: Runge-Kutta step (s); 0: one per step.
    now: time that the FMU has been brought to (s). reached: what CVODE returns it through, at address `reached_at`.
    next_event: time event that the FMU has asked for (s), infinity if none.
"""

memory_at = pointer_to(MEMORY)

CALLS = range(128, 128 + 16 * len(FUNCTIONS), 16)
"""What a bad status starts with, by the function of `FUNCTIONS` that returned it."""
(
    SET_TIME, SET_STATES, STATES, NOMINALS, DERIVATIVES, INDICATORS, EVENT_MODE, UPDATE, TIME_MODE, COMPLETED, NUMBER,
) = CALLS  # fmt: skip

NOT_FINITE, INDICATOR_NOT_FINITE, ENDLESS_UPDATE, MANY_EVENTS, PAST_EVENT, OTHER_SIZE, OVERFLOW, MANY_STEPS, FAILED = (
    range(1024, 1033)
)
"""Statuses of our own: what the FMU did is refused, or the solver gave up."""

MOST_EVENTS = 1000
"""In one step: a bridge that switches at 100 kHz makes 200 in 1 ms."""
MOST_STEPS = 100_000
"""Of the solver in one step."""
GUARD = 16
"""Numbers behind each array that the FMU writes to, which it has to leave alone."""
UNTOUCHED = -8.3817643e275
"""What they are."""


_FLAGS = {
    -3: "its error test fails again and again, however short the step",
    -4: "its iterations do not converge, however short the step",
    -22: "its input is not legal",
}


def sentence(m: Any, status: int) -> str:
    """The verb phrase for `status` of a step with the memory `m`; "" if it is not of model exchange alone."""
    prefix, names = f"fmi{m['version']}", FUNCTIONS if m["version"] == 2 else FUNCTIONS_3
    if status // 16 * 16 in CALLS:
        name = list(names.values())[CALLS.index(status // 16 * 16)]
        return f"{prefix}{name} returned {prefix}{STATUSES.get(status % 16, f' status {status % 16}')}"
    update = f"{prefix}{names['update']}"
    now, asked, element = float(m["now"]), float(m["asked"]), int(m["element"])
    own = {
        NOT_FINITE: f"said NaN or infinity for derivative {element + 1} of {m['states']} at {asked:.9g} s",
        INDICATOR_NOT_FINITE: f"said NaN or infinity for event indicator {element + 1} of {m['indicators']}",
        ENDLESS_UPDATE: f"came to no end in an event at {now:.9g} s: {update} asked for more {MOST_UPDATES} times",
        MANY_EVENTS: f"made more than {MOST_EVENTS} events in one step, the last at {now:.9g} s; it may be flickering",
        TERMINATE: "asked to terminate the simulation",
        PAST_EVENT: f"asked at {now:.9g} s for a time event at {asked:.9g} s, which is past",
        OTHER_SIZE: f"has {element} continuous states after an event at {now:.9g} s, and had {m['states']}",
        OVERFLOW: "wrote more states, derivatives or event indicators than it says it has",
        MANY_STEPS: f"let the solver make {MOST_STEPS} steps within one, up to {now:.9g} s only",
        FAILED: f"let CVODE fail at {now:.9g} s: {_FLAGS.get(int(m['flag']), 'its code is ' + str(m['flag']))}",
    }
    return own.get(status, "")


@njit(cache=True)
def brought(m, t, x):
    """Bring the FMU to time `t` and the states at `x`; 0, or a bad status."""
    status = at_time(m.set_time, (m.instance, t))
    if status > 1:
        return SET_TIME + status
    if m.states > 0:
        status = on_doubles(m.set_states, (m.instance, x, m.states))
        if status > 1:
            return SET_STATES + status
    return 0


@njit(cache=True)
def derivatives(m, t, x, dx):
    """Its derivatives at time `t` and the states at `x`, to `dx`; 0, or a bad status.

    `dx` has to have a guard behind it, see `GUARD`.
    """
    status = brought(m, t, x)
    if status != 0:
        return status
    if m.states == 0:
        return 0
    status = on_doubles(m.derivatives_of, (m.instance, dx, m.states))
    if status > 1:
        return DERIVATIVES + status
    rates = carray(doubles_at(dx), m.states)
    for i in range(m.states):
        if not np.isfinite(rates[i]):
            m.element, m.asked = i, t
            return NOT_FINITE
    return 0


@njit(cache=True)
def indicators(m, z):
    """Its event indicators where it is, to `z`, which has to have a guard; 0, or a bad status."""
    status = on_doubles(m.indicators_of, (m.instance, z, m.indicators))
    if status > 1:
        return INDICATORS + status
    values = carray(doubles_at(z), m.indicators)
    for i in range(m.indicators):
        if not np.isfinite(values[i]):
            m.element = i
            return INDICATOR_NOT_FINITE
    return 0


_words_at, _bytes_at, _counts_at = pointer_to(np.int32), pointer_to(np.uint8), pointer_to(np.int64)

NEEDED, ENDED, NOMINALS_CHANGED, _, TIME_DEFINED = range(5)
"""The flags that come back of an update, in both standards' order; in FMI 2.0 words, in FMI 3.0 bytes."""
TIME_PLACE = 24
"""Where in the memory of what comes back the time of the next event is."""


@njit(cache=True)
def slack(t):
    """Times that lie no farther apart are one (s): beyond it no solver can tell them."""
    return 1e-15 + 1e-13 * abs(t)


@njit(cache=True)
def handled(m, u, jumped):
    """Event mode, from entering to leaving it, at the time and states that the FMU is at; 0, or a bad status.

    Args:
        m: of `MEMORY`.
        u: address of the inputs.
        jumped: whether they are to be set.
    """
    status = plain(m.enter_event_mode, (m.instance,))
    if status > 1:
        return EVENT_MODE + status
    if jumped:
        status = set_all(m.version, m.instance, m.input_groups, m.inputs, u)
        if status != 0:
            return status
    status = _settled(m)
    if status != 0:
        return status
    status = plain(m.enter_time_mode, (m.instance,))
    if status > 1:
        return TIME_MODE + status
    if m.states > 0:
        status = on_doubles(m.states_of, (m.instance, m.x, m.states))
        if status > 1:
            return STATES + status
    m.restart = 1
    if m.indicators > 0 and m.cvode == 0:
        return indicators(m, m.z_before)
    return 0


@njit(cache=True)
def _flag(m, n):
    """The flag number `n` that came back."""
    return carray(_words_at(m.info), 5)[n] != 0 if m.version == 2 else carray(_bytes_at(m.info), 5)[n] != 0


@njit(cache=True)
def _settled(m):
    """Update the discrete states until that is no longer needed."""
    nominals_changed = False
    for _ in range(MOST_UPDATES):
        if m.version == 2:
            status = on_pointer(m.update, (m.instance, m.info))
        else:
            i = m.info
            status = update_3(m.update, (m.instance, i, i + 1, i + 2, i + 3, i + 4, i + TIME_PLACE))
        if status > 1:
            return UPDATE + status
        if _flag(m, ENDED):
            return TERMINATE
        nominals_changed |= _flag(m, NOMINALS_CHANGED)
        if not _flag(m, NEEDED):
            break
    else:
        return ENDLESS_UPDATE
    m.next_event = carray(doubles_at(m.info + TIME_PLACE), 1)[0] if _flag(m, TIME_DEFINED) else np.inf
    # not a number is no time either
    if not m.next_event >= m.now - slack(m.now):
        m.asked = m.next_event
        return PAST_EVENT
    return _measured(m, nominals_changed)


@njit(cache=True)
def _measured(m, nominals_changed):
    """Number and nominals of the states, which an event may have changed."""
    if m.version == 3:
        count = carray(_counts_at(m.info), 1)
        status = on_pointer(m.number_of_states, (m.instance, m.info))
        if status > 1:
            return NUMBER + status
        if count[0] != m.states:
            m.element = count[0]
            return OTHER_SIZE
    if nominals_changed and m.cvode != 0 and m.states > 0:
        status = on_doubles(m.nominals_of, (m.instance, m.scales, m.states))
        if status > 1:
            return NOMINALS + status
        weigh(carray(doubles_at(m.scales), m.states), m.tolerance)
        start_at(m.cv_tolerances, (m.cvode, m.tolerance, m.absolute))
    return 0


@njit(cache=True)
def weigh(nominals, tolerance):
    """Make absolute tolerances of nominal values, in place; what is no number above 0 counts as 1."""
    for i in range(len(nominals)):
        given = nominals[i] if nominals[i] > 0.0 and np.isfinite(nominals[i]) else 1.0
        nominals[i] = tolerance * given


@njit(cache=True)
def step_completed(m):
    """Tell the FMU that the solver has come here for good; (whether it wants an event, 0 or a bad status)."""
    if m.needs_completed == 0:
        return False, 0
    if m.version == 2:
        status = completed_2(m.completed, (m.instance, m.final, m.info, m.info + 4))
    else:
        status = completed_3(m.completed, (m.instance, m.final, m.info, m.info + 4))
    if status > 1:
        return False, COMPLETED + status
    # the second is behind four bytes: a word, or four flags
    return _flag(m, 0), TERMINATE if _flag(m, 1 if m.version == 2 else 4) else 0
