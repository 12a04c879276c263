"""Solvers for the equations of model-exchange FMUs, called by address: CVODE and Runge-Kutta.

Events are jumps of inputs, times that the FMU requested, indicators that change sign, and completed steps after which
the FMU requests an event (FMI 2.0.4, 3.2.2; FMI 3.0, 3.2).

CVODE of SUNDIALS, included in FMPy, chooses step size and order by the tolerance. It uses backward differences with
Newton iterations and a dense finite-difference Jacobian, for stiff and other equations (Hindmarsh et al. 2005, ACM
Transactions on Mathematical Software 31). Event indicators are its root functions.

The classical Runge-Kutta method of order 4 has a constant step and no error control, for small non-stiff equations. A
change of sign is detected at the end of each step and located by bisection.
"""

import ctypes
from typing import Any, Literal, NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit, pointer_to
from twin.kernel.compiled.native import Native
from twin.kernel.cosim.component import address_of, doubles_at
from twin.kernel.cosim.port import record
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import groups
from twin.kernel.settings import fields_of_form

EXCHANGE_FUNCTIONS = {
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
"""FMI 2.0 function by field of `SOLVER_MEMORY`; FMI 2.0 does not have the last one."""
EXCHANGE_FUNCTIONS_3 = EXCHANGE_FUNCTIONS | {
    "derivatives_of": "GetContinuousStateDerivatives",
    "update": "UpdateDiscreteStates",
}
SOLVER_MEMORY = record(
    **dict.fromkeys(EXCHANGE_FUNCTIONS, "i8"),
    **fields_of_form("i8", "cvode vector absolute cv_step cv_restart cv_stop cv_tolerances cv_values"),
    **fields_of_form("i8", "x began k_1 k_2 k_3 k_4 z z_before scales info last_inputs reached_at"),
    **fields_of_form("i8", "version instance note states size indicators width needs_completed final"),
    **fields_of_form("i8", "inputs input_groups outputs output_groups fresh restart trouble element flag"),
    **fields_of_form("f8", "tolerance longest now reached next_event asked"),
)
"""Addresses of FMU functions, of CVODE functions (`cvode` is 0 for Runge-Kutta) and of arrays; counts; and

    fresh: 1 until the FMU is first called.
    restart: 1 if the solver has to restart its history.
    trouble: first failure status within a call from the solver.
    element, flag, asked: number of the state, return value of CVODE, and time, for the error message.
    tolerance: relative tolerance.
    longest: Runge-Kutta step (s); 0 for one per communication step.
    now: time of the FMU (s).
    reached: time that CVODE returns (s), at address `reached_at`.
    next_event: time event that the FMU requested (s); infinity without one.
"""

memory_at = pointer_to(SOLVER_MEMORY)

CALL_STATUSES = range(128, 128 + 16 * len(EXCHANGE_FUNCTIONS), 16)
"""Failure statuses: base per function of `EXCHANGE_FUNCTIONS`, plus the returned FMI status."""
(
    SET_TIME_FAILED, SET_STATES_FAILED, GET_STATES_FAILED, NOMINALS_FAILED, DERIVATIVES_FAILED, INDICATORS_FAILED,
    EVENT_MODE_FAILED, UPDATE_FAILED, TIME_MODE_FAILED, COMPLETE_STEP_FAILED, STATE_COUNT_FAILED,
) = CALL_STATUSES  # fmt: skip

(
    NOT_FINITE,
    INDICATOR_NOT_FINITE,
    ENDLESS_UPDATE,
    TOO_MANY_EVENTS,
    PAST_EVENT,
    STATE_COUNT_CHANGED,
    ARRAY_OVERFLOW,
    TOO_MANY_STEPS,
    CVODE_FAILED,
) = range(1024, 1033)
"""Failure statuses for violations by the FMU, and failures of the solver."""

MAX_EVENTS = 1000
"""Maximum number of events in a step; a bridge that switches at 100 kHz makes 200 in 1 ms."""
MAX_SOLVER_STEPS = 100_000
"""Maximum number of solver steps in a communication step."""
GUARD_SIZE = 16
"""Number of guard values after each array that the FMU writes to."""
GUARD_VALUE = -8.3817643e275
"""Guard value; a change shows that the FMU wrote beyond the array."""


_CVODE_FLAGS = {
    -3: "its error test fails again and again, however short the step",
    -4: "its iterations do not converge, however short the step",
    -22: "its input is not legal",
}
TIME_OFFSET = 24
"""Offset (bytes) of the time of the next event in the memory of returned values."""
DEFAULT_TOLERANCE = 1e-6
"""Relative tolerance of CVODE if neither the experiment nor the FMU sets one."""
MAX_BISECTIONS = 60
"""Maximum number of bisections; the interval is then below the resolution of a double."""
CV_BDF, CV_ONE_STEP, CV_ROOT_RETURN = 2, 2, 2
"""Values of CV_BDF, CV_ONE_STEP and CV_ROOT_RETURN in cvode.h."""
RECOVERABLE_ERROR = 1
"""Result of the equations that makes CVODE retry with a smaller step."""
UPDATE_NEEDED, END_REQUESTED, NOMINALS_CHANGED, _, TIME_DEFINED = range(5)
"""Indices of the flags that an update returns, in both standards; in FMI 2.0 words, in FMI 3.0 bytes."""
_words_at, _bytes_at, _counts_at = pointer_to(np.int32), pointer_to(np.uint8), pointer_to(np.int64)
_call = "double", "pointer", "pointer", "pointer"
_C_POINTER, _C_DOUBLE, _C_INT, _C_INT64 = ctypes.c_void_p, ctypes.c_double, ctypes.c_int, ctypes.c_int64


def exchange_error(m: Any, status: int, other: int) -> str:
    """Describe a failed model-exchange step (`other`: a status outside the standard); "" for other statuses."""
    prefix, names = f"fmi{m['version']}", EXCHANGE_FUNCTIONS if m["version"] == 2 else EXCHANGE_FUNCTIONS_3
    if status // 16 * 16 in CALL_STATUSES:
        name = list(names.values())[CALL_STATUSES.index(status // 16 * 16)]
        return groups.status_phrase(f"{prefix}{name}", other if status % 16 == groups.INVALID_STATUS else status % 16)
    update = f"{prefix}{names['update']}"
    flag = _CVODE_FLAGS.get(int(m["flag"]), f"its code is {m['flag']}")
    now, asked, element = float(m["now"]), float(m["asked"]), int(m["element"])
    own = {
        NOT_FINITE: f"returned NaN or infinity for derivative {element + 1} of {m['states']} at {asked:.9g} s",
        INDICATOR_NOT_FINITE: f"returned NaN or infinity for event indicator {element + 1} of {m['indicators']}",
        ENDLESS_UPDATE: f"did not finish an event at {now:.9g} s: {update} asked for more {groups.MAX_UPDATES} times",
        TOO_MANY_EVENTS: f"made more than {MAX_EVENTS} events in one step, the last at {now:.9g} s; it may be "
        "flickering",
        groups.TERMINATE_REQUEST: "asked to terminate the simulation",
        PAST_EVENT: f"asked at {now:.9g} s for a time event at {asked:.9g} s, which is past",
        STATE_COUNT_CHANGED: f"has {element} continuous states after an event at {now:.9g} s, and had {m['states']}",
        ARRAY_OVERFLOW: "wrote more states, derivatives or event indicators than it declares",
        TOO_MANY_STEPS: f"let the solver make {MAX_SOLVER_STEPS} steps within one, up to {now:.9g} s only",
        CVODE_FAILED: f"let CVODE fail at {now:.9g} s: {flag}",
    }
    return own.get(status, "")


@njit(cache=True)
def set_time_and_states(m, t, x):
    """Set time `t` and the continuous states at address `x` in the FMU; return 0 or a failure status."""
    status = groups.failure(SET_TIME_FAILED, groups.call_time(m.set_time, (m.instance, t)))
    if status == 0 and m.states > 0:
        status = groups.failure(SET_STATES_FAILED, groups.call_doubles(m.set_states, (m.instance, x, m.states)))
    return status


@njit(cache=True)
def derivatives(m, t, x, dx):
    """Compute derivatives `dx` (address, a guard behind) at time `t` and states `x`; return 0 or a failure status."""
    status = set_time_and_states(m, t, x)
    if status == 0 and m.states > 0:
        status = groups.failure(DERIVATIVES_FAILED, groups.call_doubles(m.derivatives_of, (m.instance, dx, m.states)))
    if status != 0:
        return status
    rates = carray(doubles_at(dx), m.states)
    for i in range(m.states):
        if not np.isfinite(rates[i]):
            m.element, m.asked = i, t
            return NOT_FINITE
    return 0


@njit(cache=True)
def indicators(m, z):
    """Compute the event indicators `z` (address, a guard behind it) of the present; return 0 or a failure status."""
    status = groups.call_doubles(m.indicators_of, (m.instance, z, m.indicators))
    if status > 1:
        return INDICATORS_FAILED + status
    values = carray(doubles_at(z), m.indicators)
    for i in range(m.indicators):
        if not np.isfinite(values[i]):
            m.element = i
            return INDICATOR_NOT_FINITE
    return 0


@njit(cache=True)
def time_tolerance(t):
    """Return the tolerance within which two times count as equal (s), near the resolution of a double."""
    return 1e-15 + 1e-13 * abs(t)


@njit(cache=True)
def handle_event(m, u, jumped):
    """Handle an event at the present time, in event mode, and set inputs (address `u`) if `jumped`; return a status."""
    m.restart = 1
    status = groups.failure(EVENT_MODE_FAILED, groups.call_instance(m.enter_event_mode, (m.instance,)))
    if status == 0 and jumped:
        status = groups.set_all(m.version, m.instance, m.input_groups, m.inputs, u)
    if status == 0:
        status = _update_discrete_states(m)
    if status == 0:
        status = groups.failure(TIME_MODE_FAILED, groups.call_instance(m.enter_time_mode, (m.instance,)))
    if status == 0 and m.states > 0:
        status = groups.failure(GET_STATES_FAILED, groups.call_doubles(m.states_of, (m.instance, m.x, m.states)))
    if status == 0 and m.indicators > 0 and m.cvode == 0:
        status = indicators(m, m.z_before)
    return status


@njit(cache=True)
def _flag(m, n):
    """Return flag number `n` of the FMU's last update of discrete states, such as a request for another update."""
    return carray(_words_at(m.info), 5)[n] != 0 if m.version == 2 else carray(_bytes_at(m.info), 5)[n] != 0


@njit(cache=True)
def _update_discrete_states(m):
    """Update the FMU's discrete states until no update is needed; return 0 or a failure status."""
    nominals_changed = False
    for _ in range(groups.MAX_UPDATES):
        if m.version == 2:
            status = groups.call_pointer(m.update, (m.instance, m.info))
        else:
            i = m.info
            status = groups.update_3(m.update, (m.instance, i, i + 1, i + 2, i + 3, i + 4, i + TIME_OFFSET))
        if status > 1:
            return UPDATE_FAILED + status
        if _flag(m, END_REQUESTED):
            return groups.TERMINATE_REQUEST
        nominals_changed |= _flag(m, NOMINALS_CHANGED)
        if not _flag(m, UPDATE_NEEDED):
            break
    else:
        return ENDLESS_UPDATE
    m.next_event = carray(doubles_at(m.info + TIME_OFFSET), 1)[0] if _flag(m, TIME_DEFINED) else np.inf
    # negated so that NaN is refused, too
    if not m.next_event >= m.now - time_tolerance(m.now):
        m.asked = m.next_event
        return PAST_EVENT
    return _update_state_sizes(m, nominals_changed)


@njit(cache=True)
def _update_state_sizes(m, nominals_changed):
    """Check the FMU's number of states, and update tolerances if its nominals changed; return 0 or a failure status."""
    if m.version == 3:
        count = carray(_counts_at(m.info), 1)
        status = groups.call_pointer(m.number_of_states, (m.instance, m.info))
        if status > 1:
            return STATE_COUNT_FAILED + status
        if count[0] != m.states:
            m.element = count[0]
            return STATE_COUNT_CHANGED
    if nominals_changed and m.cvode != 0 and m.states > 0:
        status = groups.call_doubles(m.nominals_of, (m.instance, m.scales, m.states))
        if status > 1:
            return NOMINALS_FAILED + status
        scale_tolerances(carray(doubles_at(m.scales), m.states), m.tolerance)
        groups.start_at(m.cv_tolerances, (m.cvode, m.tolerance, m.absolute))
    return 0


@njit(cache=True)
def scale_tolerances(nominals, tolerance):
    """Convert nominal values to absolute tolerances in place; values that are not positive and finite count as 1."""
    for i in range(len(nominals)):
        given = nominals[i] if nominals[i] > 0.0 and np.isfinite(nominals[i]) else 1.0
        nominals[i] = tolerance * given


@njit(cache=True)
def complete_step(m):
    """Notify the FMU of a completed integrator step; return (whether it requests an event, 0 or a failure status)."""
    if m.needs_completed == 0:
        return False, 0
    if m.version == 2:
        status = groups.completed_2(m.completed, (m.instance, m.final, m.info, m.info + 4))
    else:
        status = groups.completed_3(m.completed, (m.instance, m.final, m.info, m.info + 4))
    if status > 1:
        return False, COMPLETE_STEP_FAILED + status
    # the second result is four bytes after the first: the next word, or flag number 4
    return _flag(m, 0), groups.TERMINATE_REQUEST if _flag(m, 1 if m.version == 2 else 4) else 0


class Solver(NamedTuple):
    """Integration method of a model-exchange FMU: "cvode" with error control, for all equations, or "rk4".

    "rk4" has a constant step of at most `step` (s); None for one per communication step.
    """

    method: Literal["cvode", "rk4"] = "cvode"
    step: float | None = None


@njit(cache=True)
def _move_states(m, k, h):
    """Set the states `m.x` to those at the start of the step plus `h` times the rates at address `k`."""
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    rates = carray(doubles_at(k), m.states)
    for i in range(m.states):
        x[i] = began[i] + h * rates[i]


@njit(cache=True)
def _rk4_step(m, t, h):
    """Make one Runge-Kutta step from `t`, states `m.began` and rates `m.k_1` to `m.x`; return 0 or a failure status."""
    for share, known, following in ((0.5, m.k_1, m.k_2), (0.5, m.k_2, m.k_3), (1.0, m.k_3, m.k_4)):
        _move_states(m, known, share * h)
        status = derivatives(m, t + share * h, m.x, following)
        if status != 0:
            return status
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    k_1, k_2 = carray(doubles_at(m.k_1), m.states), carray(doubles_at(m.k_2), m.states)
    k_3, k_4 = carray(doubles_at(m.k_3), m.states), carray(doubles_at(m.k_4), m.states)
    for i in range(m.states):
        x[i] = began[i] + h / 6.0 * (k_1[i] + 2.0 * k_2[i] + 2.0 * k_3[i] + k_4[i])
    return set_time_and_states(m, t + h, m.x)


@njit(cache=True)
def _detect_crossing(m):
    """Detect a sign change of an event indicator since `m.z_before`; return (whether found, 0 or a failure status)."""
    status = indicators(m, m.z)
    z, before = carray(doubles_at(m.z), m.indicators), carray(doubles_at(m.z_before), m.indicators)
    for i in range(m.indicators):
        if (z[i] > 0.0) != (before[i] > 0.0):
            return status == 0, status
    return False, status


@njit(cache=True)
def _locate_crossing(m, t, h):
    """Locate an indicator's sign change in a step by bisection; return (time after `t` (s), 0 or a failure status)."""
    low, high = 0.0, h
    for _ in range(MAX_BISECTIONS):
        if high - low <= time_tolerance(t):
            break
        middle = 0.5 * (low + high)
        status = _rk4_step(m, t, middle)
        if status != 0:
            return high, status
        crossed, status = _detect_crossing(m)
        if status != 0:
            return high, status
        if crossed:
            high = middle
        else:
            low = middle
    return high, _rk4_step(m, t, high)


@njit(cache=True)
def integrate_rk4(m, stop):
    """Integrate the equations by Runge-Kutta up to `stop` or an event; return (event found, 0 or a failure status)."""
    span, start = stop - m.now, m.now
    steps = max(1, int(np.ceil(span / m.longest - 1e-9))) if m.longest > 0.0 else 1
    for n in range(steps):
        x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
        for i in range(m.states):
            began[i] = x[i]
        end = stop if n == steps - 1 else start + span * (n + 1) / steps
        h = end - m.now
        status = derivatives(m, m.now, m.began, m.k_1)
        if status == 0:
            status = _rk4_step(m, m.now, h)
        crossed = False
        if m.indicators > 0 and status == 0:
            crossed, status = _detect_crossing(m)
            if crossed and status == 0:
                h, status = _locate_crossing(m, m.now, h)
                end = min(m.now + h, end)
        if status != 0:
            return False, status
        m.now = end
        wanted, status = complete_step(m)
        if status != 0 or wanted or crossed:
            return wanted or crossed, status
    return False, 0


def _right_hand_side(t, y, ydot, user):
    m = carray(memory_at(address_of(user)), 1)[0]
    status = derivatives(m, t, groups.values_of(m.cv_values, (address_of(y),)), m.k_1)
    if status == 0:
        copy(groups.values_of(m.cv_values, (address_of(ydot),)), m.k_1, 8 * m.size)
        return 0
    m.trouble = status
    # after NaN or Discard a smaller step may succeed, as the states may have left the FMU's range
    return RECOVERABLE_ERROR if status == NOT_FINITE or status % 16 == 2 else -1


def _roots(t, y, values, user):
    m = carray(memory_at(address_of(user)), 1)[0]
    status = set_time_and_states(m, t, groups.values_of(m.cv_values, (address_of(y),)))
    if status == 0:
        status = indicators(m, m.z)
    if status == 0:
        copy(address_of(values), m.z, 8 * m.indicators)
        return 0
    m.trouble = status
    return -1


right_hand_side, roots = Native("int32", _call, _right_hand_side), Native("int32", _call, _roots)


@njit(cache=True)
def integrate_cvode(m, stop):
    """Integrate the equations by CVODE up to `stop` or an event; return (event found, 0 or a failure status)."""
    m.trouble = 0
    if m.restart != 0:
        groups.start_at(m.cv_restart, (m.cvode, m.now, m.vector))
        m.restart = 0
    groups.call_time(m.cv_stop, (m.cvode, stop))
    for _ in range(MAX_SOLVER_STEPS):
        flag = groups.one_step(m.cv_step, (m.cvode, stop, m.vector, m.reached_at, CV_ONE_STEP))
        if flag < 0:
            m.flag = flag
            return False, m.trouble if m.trouble != 0 else CVODE_FAILED
        m.now = m.reached
        arrived = m.now >= stop
        if m.needs_completed != 0 or arrived or flag == CV_ROOT_RETURN:
            status = set_time_and_states(m, m.now, m.x)
            wanted = False
            if status == 0:
                wanted, status = complete_step(m)
            if status != 0 or wanted or flag == CV_ROOT_RETURN or arrived:
                return wanted or flag == CV_ROOT_RETURN, status
    return False, TOO_MANY_STEPS


class Cvode:
    """A CVODE solver of SUNDIALS, with its state vector, Jacobian and root functions.

    It changes the states `x` (n,) in place, with `absolute` tolerances (n,), and passes the memory at address `user` to
    the equations. `addresses` are for the compiled step, by field of `SOLVER_MEMORY`.
    """

    def __init__(self, x: np.ndarray, absolute: np.ndarray, tolerance: float, indicators: int, user: int):
        try:
            from fmpy.sundials import libraries
        # FMPy raises bare Exception for another library version, ctypes OSError for a missing library
        except Exception as problem:
            raise InputRefused(f'CVODE does not load: {problem}; use [drive] solver = "rk4"') from None
        core, cvode, vectors = libraries.sundials_core, libraries.sundials_cvode, libraries.sundials_nvecserial
        context = ctypes.c_void_p()
        _function(core, "SUNContext_Create", _C_INT, _C_INT, _C_POINTER)(0, ctypes.addressof(context))
        # without error handlers, which would print errors
        _function(core, "SUNContext_ClearErrHandlers", None, _C_POINTER)(context)
        made = _function(vectors, "N_VMake_Serial", _C_POINTER, _C_INT64, _C_POINTER, _C_POINTER)
        vector, weights = (made(len(values), values.ctypes.data, context) for values in (x, absolute))
        matrix = _function(
            libraries.sundials_sunmatrixdense, "SUNDenseMatrix", _C_POINTER, _C_INT64, _C_INT64, _C_POINTER
        )(len(x), len(x), context)
        linear = _function(
            libraries.sundials_sunlinsoldense, "SUNLinSol_Dense", _C_POINTER, _C_POINTER, _C_POINTER, _C_POINTER
        )(vector, matrix, context)
        memory = _function(cvode, "CVodeCreate", _C_POINTER, _C_INT, _C_POINTER)(CV_BDF, context)
        _function(cvode, "CVodeInit", _C_INT, _C_POINTER, _C_POINTER, _C_DOUBLE, _C_POINTER)(
            memory, right_hand_side.address, 0.0, vector
        )
        _function(cvode, "CVodeSVtolerances", _C_INT, _C_POINTER, _C_DOUBLE, _C_POINTER)(memory, tolerance, weights)
        _function(cvode, "CVodeSetLinearSolver", _C_INT, _C_POINTER, _C_POINTER, _C_POINTER)(memory, linear, matrix)
        _function(cvode, "CVodeSetUserData", _C_INT, _C_POINTER, _C_POINTER)(memory, user)
        _function(cvode, "CVodeSetMaxHnilWarns", _C_INT, _C_POINTER, _C_INT)(memory, -1)
        if indicators:
            _function(cvode, "CVodeRootInit", _C_INT, _C_POINTER, _C_INT, _C_POINTER)(memory, indicators, roots.address)
            _function(cvode, "CVodeSetNoInactiveRootWarn", _C_INT, _C_POINTER)(memory)
        self.addresses = {"cvode": memory, "vector": vector, "absolute": weights}
        for field, library, name in (
            ("cv_step", cvode, "CVode"),
            ("cv_restart", cvode, "CVodeReInit"),
            ("cv_stop", cvode, "CVodeSetStopTime"),
            ("cv_tolerances", cvode, "CVodeSVtolerances"),
            ("cv_values", core, "N_VGetArrayPointer"),
        ):
            self.addresses[field] = ctypes.cast(getattr(library, name), _C_POINTER).value
        self._last = (x, absolute)
        self._parts: tuple[Any, ...] = (memory, linear, matrix, (vector, weights), context)

    def close(self) -> None:
        """Free the CVODE solver; safe to call twice."""
        if not self._parts:
            return
        from fmpy.sundials.libraries import sundials_core as core
        from fmpy.sundials.libraries import sundials_cvode as cvode

        memory, linear, matrix, vectors, context = self._parts
        self._parts = ()
        _function(cvode, "CVodeFree", None, _C_POINTER)(ctypes.addressof(ctypes.c_void_p(memory)))
        _function(core, "SUNLinSolFree", _C_INT, _C_POINTER)(linear)
        _function(core, "SUNMatDestroy", None, _C_POINTER)(matrix)
        for vector in vectors:
            _function(core, "N_VDestroy", None, _C_POINTER)(vector)
        _function(core, "SUNContext_Free", _C_INT, _C_POINTER)(ctypes.addressof(context))


def _function(library: ctypes.CDLL, name: str, returns: Any, *kinds: Any) -> Any:
    return ctypes.CFUNCTYPE(returns, *kinds)((name, library))
