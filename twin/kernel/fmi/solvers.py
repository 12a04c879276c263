"""Solvers for the equations of a model-exchange FMU, by address.

CVODE of SUNDIALS, which FMPy brings along: step size and order as the tolerance asks, backward differences with Newton
iterations and a dense Jacobian by differences, for stiff equations and others (Hindmarsh et al. 2005, ACM Transactions
on Mathematical Software 31); event indicators are its root functions.

The classical Runge-Kutta method of order 4 goes in steps of one length, for small equations that are not stiff. It
holds no tolerance. An event is looked for at the end of each step and found by halving the step before it.
"""

import ctypes
from typing import Any, Literal, NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit
from twin.kernel.compiled.native import Native
from twin.kernel.cosim.component import address_of, doubles_at
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.equations import (
    FAILED,
    MANY_STEPS,
    MOST_STEPS,
    NOT_FINITE,
    brought,
    derivatives,
    indicators,
    memory_at,
    slack,
    step_completed,
)
from twin.kernel.fmi.groups import at_time, one_step, start_at, values_of

USUAL_TOLERANCE = 1e-6
"""Relative, of CVODE, where neither the experiment nor the FMU says anything."""


class Solver(NamedTuple):
    """What integrates the equations of an FMU.

    Attributes:
        method: "cvode" holds a tolerance, whatever the equations are; "rk4" goes in steps of one length.
        step: longest step of "rk4" (s); None: one per step of the drive.
    """

    method: Literal["cvode", "rk4"] = "cvode"
    step: float | None = None


HALVINGS = 60
"""A step halved so often is shorter than two times that differ."""


@njit(cache=True)
def _moved(m, k, h):
    """The states at the start of the step and `h` times the rates at `k`, to `m.x`."""
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    rates = carray(doubles_at(k), m.states)
    for i in range(m.states):
        x[i] = began[i] + h * rates[i]


@njit(cache=True)
def _stepped(m, t, h):
    """One step from time `t` and the states at `m.began`, whose rates are at `m.k_1`, to `m.x`; 0 or a bad status."""
    _moved(m, m.k_1, 0.5 * h)
    status = derivatives(m, t + 0.5 * h, m.x, m.k_2)
    if status != 0:
        return status
    _moved(m, m.k_2, 0.5 * h)
    status = derivatives(m, t + 0.5 * h, m.x, m.k_3)
    if status != 0:
        return status
    _moved(m, m.k_3, h)
    status = derivatives(m, t + h, m.x, m.k_4)
    if status != 0:
        return status
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    k_1, k_2 = carray(doubles_at(m.k_1), m.states), carray(doubles_at(m.k_2), m.states)
    k_3, k_4 = carray(doubles_at(m.k_3), m.states), carray(doubles_at(m.k_4), m.states)
    for i in range(m.states):
        x[i] = began[i] + h / 6.0 * (k_1[i] + 2.0 * k_2[i] + 2.0 * k_3[i] + k_4[i])
    return brought(m, t + h, m.x)


@njit(cache=True)
def _crossed(m):
    """Whether an indicator has another sign than before; (that, 0 or a bad status)."""
    status = indicators(m, m.z)
    z, before = carray(doubles_at(m.z), m.indicators), carray(doubles_at(m.z_before), m.indicators)
    for i in range(m.indicators):
        if (z[i] > 0.0) != (before[i] > 0.0):
            return status == 0, status
    return False, status


@njit(cache=True)
def _located(m, t, h):
    """How long after `t` an indicator has changed its sign (s), which it has after `h`; (that, 0 or a bad status)."""
    low, high = 0.0, h
    for _ in range(HALVINGS):
        if high - low <= slack(t):
            break
        middle = 0.5 * (low + high)
        status = _stepped(m, t, middle)
        if status != 0:
            return high, status
        crossed, status = _crossed(m)
        if status != 0:
            return high, status
        if crossed:
            high = middle
        else:
            low = middle
    return high, _stepped(m, t, high)


@njit(cache=True)
def integrate_rk4(m, stop):
    """From `m.now` to `stop`, or to an event before it; (whether there is one, 0 or a bad status)."""
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
            status = _stepped(m, m.now, h)
        crossed = False
        if m.indicators > 0 and status == 0:
            crossed, status = _crossed(m)
            if crossed and status == 0:
                h, status = _located(m, m.now, h)
                end = min(m.now + h, end)
        if status != 0:
            return False, status
        m.now = end
        wanted, status = step_completed(m)
        if status != 0 or wanted or crossed:
            return wanted or crossed, status
    return False, 0


BDF, ONE_STEP, ROOT_RETURN = 2, 2, 2
"""CV_BDF, CV_ONE_STEP and CV_ROOT_RETURN of cvode.h."""
RECOVERABLE = 1
"""What the equations return for CVODE to try a smaller step."""
_P, _D, _I, _N = ctypes.c_void_p, ctypes.c_double, ctypes.c_int, ctypes.c_int64
_call = "double", "pointer", "pointer", "pointer"


def _right_hand_side(t, y, ydot, user):
    m = carray(memory_at(address_of(user)), 1)[0]
    status = derivatives(m, t, values_of(m.cv_values, (address_of(y),)), m.k_1)
    if status == 0:
        copy(values_of(m.cv_values, (address_of(ydot),)), m.k_1, 8 * m.size)
        return 0
    m.trouble = status
    # NaN, or Discard: the states may be out of its range, and nearer ones not
    return RECOVERABLE if status == NOT_FINITE or status % 16 == 2 else -1


def _roots(t, y, values, user):
    m = carray(memory_at(address_of(user)), 1)[0]
    status = brought(m, t, values_of(m.cv_values, (address_of(y),)))
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
    """From `m.now` to `stop`, or to an event before it; (whether there is one, 0 or a bad status)."""
    m.trouble = 0
    if m.restart != 0:
        start_at(m.cv_restart, (m.cvode, m.now, m.vector))
        m.restart = 0
    at_time(m.cv_stop, (m.cvode, stop))
    for _ in range(MOST_STEPS):
        flag = one_step(m.cv_step, (m.cvode, stop, m.vector, m.reached_at, ONE_STEP))
        if flag < 0:
            m.flag = flag
            return False, m.trouble if m.trouble != 0 else FAILED
        m.now = m.reached
        arrived = m.now >= stop
        if m.needs_completed != 0 or arrived or flag == ROOT_RETURN:
            status = brought(m, m.now, m.x)
            wanted = False
            if status == 0:
                wanted, status = step_completed(m)
            if status != 0 or wanted or flag == ROOT_RETURN or arrived:
                return wanted or flag == ROOT_RETURN, status
    return False, MANY_STEPS


class Cvode:
    """A solver's memory.

    Args:
        x: its states, (n,), which it works on.
        absolute: tolerances of each, (n,).
        tolerance: relative.
        indicators: number of event indicators.
        user: address of the memory that the equations are called with.

    Attributes:
        addresses: what the compiled step needs to know, by field of `equations.MEMORY`.

    Raises:
        InputRefused: FMPy brings no CVODE for this platform.
    """

    def __init__(self, x: np.ndarray, absolute: np.ndarray, tolerance: float, indicators: int, user: int):
        try:
            from fmpy.sundials import libraries
        # FMPy raises bare Exception for a library of another version, ctypes OSError for none
        except Exception as problem:
            raise InputRefused(f'CVODE does not load: {problem}; use [drive] solver = "rk4"') from None
        core, cvode, vectors = libraries.sundials_core, libraries.sundials_cvode, libraries.sundials_nvecserial
        context = ctypes.c_void_p()
        _function(core, "SUNContext_Create", _I, _I, _P)(0, ctypes.addressof(context))
        # it would print what goes wrong
        _function(core, "SUNContext_ClearErrHandlers", None, _P)(context)
        made = _function(vectors, "N_VMake_Serial", _P, _N, _P, _P)
        vector, weights = (made(len(values), values.ctypes.data, context) for values in (x, absolute))
        matrix = _function(libraries.sundials_sunmatrixdense, "SUNDenseMatrix", _P, _N, _N, _P)(len(x), len(x), context)
        linear = _function(libraries.sundials_sunlinsoldense, "SUNLinSol_Dense", _P, _P, _P, _P)(
            vector, matrix, context
        )
        memory = _function(cvode, "CVodeCreate", _P, _I, _P)(BDF, context)
        _function(cvode, "CVodeInit", _I, _P, _P, _D, _P)(memory, right_hand_side.address, 0.0, vector)
        _function(cvode, "CVodeSVtolerances", _I, _P, _D, _P)(memory, tolerance, weights)
        _function(cvode, "CVodeSetLinearSolver", _I, _P, _P, _P)(memory, linear, matrix)
        _function(cvode, "CVodeSetUserData", _I, _P, _P)(memory, user)
        _function(cvode, "CVodeSetMaxHnilWarns", _I, _P, _I)(memory, -1)
        if indicators:
            _function(cvode, "CVodeRootInit", _I, _P, _I, _P)(memory, indicators, roots.address)
            _function(cvode, "CVodeSetNoInactiveRootWarn", _I, _P)(memory)
        self.addresses = {"cvode": memory, "vector": vector, "absolute": weights}
        for field, library, name in (
            ("cv_step", cvode, "CVode"),
            ("cv_restart", cvode, "CVodeReInit"),
            ("cv_stop", cvode, "CVodeSetStopTime"),
            ("cv_tolerances", cvode, "CVodeSVtolerances"),
            ("cv_values", core, "N_VGetArrayPointer"),
        ):
            self.addresses[field] = ctypes.cast(getattr(library, name), _P).value
        self._last = (x, absolute)
        self._parts: tuple[Any, ...] = (memory, linear, matrix, (vector, weights), context)

    def close(self) -> None:
        """Free it; safe to call twice."""
        if not self._parts:
            return
        from fmpy.sundials.libraries import sundials_core as core
        from fmpy.sundials.libraries import sundials_cvode as cvode

        memory, linear, matrix, vectors, context = self._parts
        self._parts = ()
        _function(cvode, "CVodeFree", None, _P)(ctypes.addressof(ctypes.c_void_p(memory)))
        _function(core, "SUNLinSolFree", _I, _P)(linear)
        _function(core, "SUNMatDestroy", None, _P)(matrix)
        for vector in vectors:
            _function(core, "N_VDestroy", None, _P)(vector)
        _function(core, "SUNContext_Free", _I, _P)(ctypes.addressof(context))


def _function(library: ctypes.CDLL, name: str, returns: Any, *kinds: Any) -> Any:
    """A function of `library`, with types of its own."""
    return ctypes.CFUNCTYPE(returns, *kinds)((name, library))
