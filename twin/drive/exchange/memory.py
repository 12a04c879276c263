"""What the compiled step of a model-exchange FMU works on, and what its bad statuses say."""

import numpy as np

from twin.compiled.function import pointer_to

_FUNCTIONS = (
    "set_time",
    "set_states",
    "states_of",
    "nominals_of",
    "derivatives_of",
    "indicators_of",
    "enter_event_mode",
    "update",
    "enter_time_mode",
    "completed",
    "number_of_states",
)
_SOLVER = ("cvode", "vector", "absolute", "cv_step", "cv_restart", "cv_stop", "cv_tolerances", "cv_values")
_ARRAYS = ("x", "began", "k_1", "k_2", "k_3", "k_4", "z", "z_before", "scales", "info", "last_inputs", "reached_at")
_COUNTS = ("version", "instance", "states", "size", "indicators", "width", "needs_completed", "final")
_PORTS = ("inputs", "input_groups", "outputs", "output_groups")
_MOVING = ("fresh", "restart", "trouble", "element", "flag")

MEMORY = np.dtype(
    [(name, "i8") for name in (*_FUNCTIONS, *_SOLVER, *_ARRAYS, *_COUNTS, *_PORTS, *_MOVING)]
    + [(name, "f8") for name in ("tolerance", "longest", "now", "reached", "next_event", "asked")],
    align=True,
)
"""Addresses of the FMU's functions, of CVODE's (`cvode` 0: Runge-Kutta) and of arrays; numbers of things; and

    fresh: 1: nothing has been told to the FMU yet.
    restart: 1: the solver has to begin anew.
    trouble: status of the first thing that went wrong in a call that the solver made.
    element, flag, asked: which state, which return value of CVODE, which time, for the sentence.
    tolerance: relative.
    longest: Runge-Kutta step (s); 0: one per step.
    now: time that the FMU has been brought to (s). reached: what CVODE returns it through, at address `reached_at`.
    next_event: time event that the FMU has asked for (s), infinity if none.
"""

memory_at = pointer_to(MEMORY)

CALLS = {
    128: "SetTime",
    144: "SetContinuousStates",
    160: "GetContinuousStates",
    176: "GetNominalsOfContinuousStates",
    192: "GetDerivatives",
    208: "GetEventIndicators",
    224: "EnterEventMode",
    240: "NewDiscreteStates",
    256: "EnterContinuousTimeMode",
    272: "CompletedIntegratorStep",
    288: "GetNumberOfContinuousStates",
}
"""What a bad status starts with, and the function of FMI 2.0 that returned it."""
(
    SET_TIME, SET_STATES, STATES, NOMINALS, DERIVATIVES, INDICATORS, EVENT_MODE, UPDATE, TIME_MODE, COMPLETED, NUMBER,
) = CALLS  # fmt: skip
CALLS_3 = {
    DERIVATIVES: "GetContinuousStateDerivatives",
    UPDATE: "UpdateDiscreteStates",
}
"""Those that FMI 3.0 calls otherwise."""

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
