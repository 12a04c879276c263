"""The compiled steps of co-simulation FMUs without events: set inputs, step, get outputs, all by address.

A slave of FMI 1.0 or 2.0 that discards a step has computed a part of it, perhaps none (FMI 2.0.4, 4.2.2). It is asked
how far it got and stepped from there, over what it has shown that it can do, over half of the step if it has shown
nothing, and over longer parts again as long as that goes well. To repeat a step, the FMU's state is saved and restored
(FMI 2.0.4, 2.1.8; FMI 3.0, 2.2.5).
"""

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import address_of, bytes_at, keep_pieces, put_back_pieces, step_function
from twin.kernel.cosim.port import record, state
from twin.kernel.fmi.groups import (
    DISCARD,
    DO_STEP,
    EARLY,
    GET,
    MOST_STEPS,
    OUTSIDE,
    RESTORE,
    SAVE,
    SET,
    SHORTENED,
    STUCK,
    TERMINATE,
    TOO_MANY,
    access_2,
    ask_status,
    begin_ramp,
    do_step_2,
    do_step_3,
    get_all,
    on_pointer,
    set_all,
    set_ramp,
)

SHORTER = record(
    real_status="i8",  # fmiNGetRealStatus
    boolean_status="i8",  # fmi2GetBooleanStatus; 0 in FMI 1.0
    value="f8",  # what the first returns
    flag="i8",  # what the second returns
    value_at="i8",  # where these two are
    flag_at="i8",
    varies="i8",  # whether the FMU takes steps of varying size
    discarded=state("i8"),  # how many steps it has discarded
    since=state("f8"),  # when the first (s)
)
"""What goes on after a discarded step; addresses of functions."""

LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3
"""fmi2StatusKind, and fmiStatusKind for the first."""

_shorter_at = pointer_to(SHORTER)


@njit(cache=True)
def _reached(s, instance, here, goal, close):
    """(time that the FMU has reached, 0), or (NaN, status) if the run ends with that."""
    s.flag, s.value = 0, np.nan
    if s.boolean_status != 0 and ask_status(s.boolean_status, (instance, TERMINATED, s.flag_at)) <= 1 and s.flag != 0:
        return np.nan, TERMINATE
    if ask_status(s.real_status, (instance, LAST_SUCCESSFUL_TIME, s.value_at)) > 1 or s.varies == 0:
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
        status = do_step_2(do_step, (instance, here, part, final))
    s.value = here
    return TOO_MANY


MEMORY = record(
    version="i8",
    instance="i8",
    do_step="i8",
    final="i8",  # 1: no state will be restored
    inputs="i8",  # how many groups
    input_groups="i8",  # of `groups.GROUP`
    outputs="i8",
    output_groups="i8",
    returned="i8",  # 16 bytes for what fmi3DoStep returns
    ramp="i8",  # a `groups.RAMP`; 0: no input is a line
    shorter="i8",  # a `SHORTER`
)
"""Of an instance: counts, and addresses of functions and tables."""


@step_function(MEMORY)
def step(m, t, h, u, y):
    status = set_all(m.version, m.instance, m.input_groups, m.inputs, address_of(u))
    if status != 0:
        return status
    if m.version < 3:
        if m.ramp != 0:
            begin_ramp(m.ramp, address_of(u), t, h)
            status = set_ramp(m.ramp, t)
            if status != 0:
                return status
        status = do_step_2(m.do_step, (m.instance, t, h, m.final))
        if status == DISCARD:
            status = go_on(m.shorter, m.ramp, m.do_step, m.instance, t, h, m.final)
            if status != 0:
                return status
    else:
        # an FMU of 3.0 that takes lines is stepped as one with events
        back = m.returned
        status = do_step_3(m.do_step, (m.instance, t, h, m.final, back + 8, back + 9, back + 10, back))
        if status <= 1:
            flags = carray(bytes_at(m.returned), 16)
            if flags[9]:
                return TERMINATE
            if flags[10]:
                return EARLY
    if status > 1:
        return DO_STEP + status
    return get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))


PLAIN_MEMORY = record(
    instance="i8",
    set_real="i8",
    do_step="i8",
    final="i8",
    get_real="i8",
    inputs="i8",  # how many
    input_references="i8",
    outputs="i8",
    output_references="i8",
    shifted="i8",  # which output
    shift="f8",  # and by how much
    shorter="i8",  # a `SHORTER`
)
"""The same of an FMU whose values go as they are."""


@step_function(PLAIN_MEMORY)
def plain_step(m, t, h, u, y):
    # what `step` does for Real in SI units and the contract's order, in a third of the time around the FMU's own
    status = access_2(m.set_real, (m.instance, m.input_references, m.inputs, address_of(u)))
    if status > 1:
        return SET + status
    status = do_step_2(m.do_step, (m.instance, t, h, m.final))
    if status == DISCARD:
        status = go_on(m.shorter, 0, m.do_step, m.instance, t, h, m.final)
        if status != 0:
            return status
    if status > 1:
        return DO_STEP + status
    status = access_2(m.get_real, (m.instance, m.output_references, m.outputs, address_of(y)))
    if status > 1:
        return GET + status
    carray(y, m.outputs)[m.shifted] += m.shift
    return 0


STATE_MEMORY = record(
    instance="i8",
    get="i8",  # fmiNGetFMUState
    set="i8",  # fmiNSetFMUState
    cell="i8",  # where the next field is
    state="i8",  # the FMU's own pointer
    pieces="i8",  # how many of our own memory go back with it
    piece_table="i8",  # of `component.PIECE`
)
"""To save and restore a state; addresses of functions."""


@step_function(STATE_MEMORY)
def save(m, t, h, u, y):
    status = on_pointer(m.get, (m.instance, m.cell))
    keep_pieces(m.piece_table, m.pieces)
    return SAVE + status if status > 1 else 0


@step_function(STATE_MEMORY)
def restore(m, t, h, u, y):
    status = on_pointer(m.set, (m.instance, m.state))
    put_back_pieces(m.piece_table, m.pieces)
    return RESTORE + status if status > 1 else 0
