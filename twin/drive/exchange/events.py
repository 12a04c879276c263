"""Events: inputs that jump, times that the FMU asked for, indicators that change sign, steps after which it wants one.

FMI 2.0.4, 3.2.2; FMI 3.0, 3.2.
"""

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.cosim.native import doubles_at
from twin.drive.adapter import set_all
from twin.drive.exchange.calls import completed_2, completed_3, on_doubles, on_pointer, plain, start_at, update_3
from twin.drive.exchange.equations import indicators
from twin.drive.exchange.memory import (
    COMPLETED,
    ENDLESS_UPDATE,
    EVENT_MODE,
    NOMINALS,
    NUMBER,
    OTHER_SIZE,
    PAST_EVENT,
    STATES,
    TIME_MODE,
    UPDATE,
)
from twin.drive.status import MOST_UPDATES, TERMINATE

_words_at, _bytes_at, _counts_at = pointer_to(np.int32), pointer_to(np.uint8), pointer_to(np.int64)

NEEDED, ENDED, NOMINALS_CHANGED, STATES_CHANGED, TIME_DEFINED = range(5)
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
def _settled(m):
    """Update the discrete states until that is no longer needed."""
    nominals_changed = False
    for _ in range(MOST_UPDATES):
        if m.version == 2:
            status = on_pointer(m.update, (m.instance, m.info))
            flags = carray(_words_at(m.info), 5)
            needed, ended = flags[NEEDED] != 0, flags[ENDED] != 0
            scaled, timed = flags[NOMINALS_CHANGED] != 0, flags[TIME_DEFINED] != 0
        else:
            i = m.info
            status = update_3(m.update, (m.instance, i, i + 1, i + 2, i + 3, i + 4, i + TIME_PLACE))
            bits = carray(_bytes_at(m.info), 5)
            needed, ended = bits[NEEDED] != 0, bits[ENDED] != 0
            scaled, timed = bits[NOMINALS_CHANGED] != 0, bits[TIME_DEFINED] != 0
        if status > 1:
            return UPDATE + status
        if ended:
            return TERMINATE
        nominals_changed |= scaled
        if not needed:
            break
    else:
        return ENDLESS_UPDATE
    m.next_event = carray(doubles_at(m.info + TIME_PLACE), 1)[0] if timed else np.inf
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
        flags = carray(_words_at(m.info), 2)
        wanted, ended = flags[0] != 0, flags[1] != 0
    else:
        status = completed_3(m.completed, (m.instance, m.final, m.info, m.info + 4))
        bits = carray(_bytes_at(m.info), 5)
        wanted, ended = bits[0] != 0, bits[4] != 0
    if status > 1:
        return False, COMPLETED + status
    return wanted, TERMINATE if ended else 0
