"""Compiled steps of co-simulation FMUs: set inputs, step, get outputs, all by address.

An FMU of FMI 1.0 or 2.0 that discards a step has computed a part of it, possibly nothing (FMI 2.0.4, 4.2.2). It is
queried for the time reached and continued from there, with steps of the size that succeeded, or of half the size
without a success; sizes are doubled while steps succeed. To repeat a step, the FMU's state is saved and restored (FMI
2.0.4, 2.1.8; FMI 3.0, 2.2.5).

FMI 3.0 FMUs that have event mode, may return early, or have interpolated inputs are stepped in a loop: step to the end
of the tick or the next planned event, handle events, and repeat until the end of the tick. Without events the loop
runs once. In event mode (2.3.5, 4.2.1) due clocks are ticked, discrete inputs set, and clocked outputs read.
"""

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit, pointer_to
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import address_of, bytes_at, copy_pieces, doubles_at, step_function
from twin.kernel.cosim.port import record, state
from twin.kernel.fmi import groups
from twin.kernel.settings import fields_of_form

DISCARD_RECORD = record(
    real_status="i8",  # address of fmiNGetRealStatus
    boolean_status="i8",  # address of fmi2GetBooleanStatus; 0 in FMI 1.0
    value="f8",  # result of real_status
    flag="i8",  # result of boolean_status
    value_at="i8",  # address of value
    flag_at="i8",  # address of flag
    varies="i8",  # whether the FMU accepts a variable step size
    discarded=state("i8"),  # number of discarded steps
    since=state("f8"),  # time of the first one (s)
)

LAST_SUCCESSFUL_TIME, TERMINATED_KIND = 2, 3
"""Values of fmi2StatusKind, and of fmiStatusKind for the first."""

_shorter_at = pointer_to(DISCARD_RECORD)
STEP_MEMORY = record(
    **fields_of_form("i8", "version instance do_step"),
    final="i8",  # 1 if no state will be restored
    inputs="i8",  # number of groups
    input_groups="i8",  # address of `groups.GROUP_RECORD`
    outputs="i8",
    output_groups="i8",
    returned="i8",  # address of 16 bytes for results of fmi3DoStep
    ramp="i8",  # address of `groups.RAMP_RECORD`; 0 without interpolated inputs
    shorter="i8",  # address of a `DISCARD_RECORD`
    note="i8",  # address of a `groups.NOTE_RECORD`
)
"""Memory of the general step: counts, and addresses of functions and tables."""
PLAIN_MEMORY = record(
    **fields_of_form("i8", "instance set_real do_step final get_real"),
    inputs="i8",  # number of inputs
    **fields_of_form("i8", "input_references outputs output_references"),
    shifted="i8",  # index of the shifted output
    shift="f8",  # offset added to it
    shorter="i8",  # address of a `DISCARD_RECORD`
    note="i8",  # address of a `groups.NOTE_RECORD`
)
"""Memory of the step of an FMU whose values need no conversion."""
STATE_MEMORY = record(
    instance="i8",
    get="i8",  # address of fmiNGetFMUState
    set="i8",  # address of fmiNSetFMUState
    cell="i8",  # address of the next field
    state="i8",  # pointer to the FMU's state
    pieces="i8",  # number of pieces of memory outside the FMU
    piece_table="i8",  # address of `component.PIECE_RECORD`
    note="i8",  # address of a `groups.NOTE_RECORD`
)
"""Memory for saving and restoring a state; addresses of functions."""
PERIODIC_CLOCK, CHANGING_CLOCK, COUNTDOWN_CLOCK, OUTPUT_CLOCK = 0, 1, 2, 3
"""Kinds of clocks: the period gives the next tick, the FMU reports it at each tick, the FMU reports it at each event,
or the FMU itself activates the clock."""
UNKNOWN_STEP = 1 << 62
"""Step of a clock whose next tick is not known."""
CLOCK_RECORD = np.dtype([("reference", "u4"), ("kind", "i4"), ("period", "i8"), ("next", "i8")], align=True)
"""Clock data: value reference, kind, period (steps), and the step at whose beginning it ticks next."""
CLOCK_BYTES = CLOCK_RECORD.itemsize
EVENTS_RECORD = record(
    **fields_of_form("i8", "instance enter_event_mode update enter_step_mode set_clock get_clock get_interval"),
    returned="i8",  # address of 40 bytes for results of functions
    clocks="i8",  # number of clocks
    clock_table="i8",  # address of `CLOCK_RECORD`
    discrete="i8",  # number of groups of discrete inputs
    discrete_groups="i8",
    held="i8",  # number of groups of clocked outputs
    held_groups="i8",
    next="i8",  # address of the time of the next event (s); infinity if not planned
    step="f8",  # step size (s)
    value="f8",  # value that the FMU returned with a failure
    culprit="i8",  # clock that it concerns
)
"""Memory of event mode: counts, and addresses of functions and tables."""
_VALUE_OFFSET, _ANSWER_OFFSET = 16, 24
"""Offsets (bytes) in `returned` of a clock's value and of the answer, after the 16 bytes of the update."""
EVENT_MEMORY = record(
    **fields_of_form("i8", "instance do_step final inputs input_groups outputs output_groups"),
    held="i8",  # number of groups of clocked outputs, which are read in events
    **fields_of_form("i8", "held_groups returned ramp"),
    events="i8",  # address of an `EVENTS_RECORD`; 0 without event mode
    next="i8",  # address of the time of the next event
    clocks="i8",  # number of clocks
    discrete="i8",  # number of groups of discrete inputs
    early="i8",  # whether a step may return early
    varies="i8",  # whether the FMU accepts a variable step size
    value="f8",  # time that the FMU returned with a failure
    note="i8",  # address of a `groups.NOTE_RECORD`
)
"""Memory of the step with events: fields of `STEP_MEMORY`, and of events."""
_events_at, _clocks_at = pointer_to(EVENTS_RECORD), pointer_to(CLOCK_RECORD)
_words_at = pointer_to(np.int32)


@njit(cache=True)
def _reached_time(s, instance, here, goal, close):
    """Query the time that the FMU has reached in a discarded step; return (time, 0), or (NaN, failure status)."""
    s.flag, s.value = 0, np.nan
    if (
        s.boolean_status != 0
        and groups.ask_status(s.boolean_status, (instance, TERMINATED_KIND, s.flag_at)) <= 1
        and s.flag != 0
    ):
        return np.nan, groups.TERMINATE_REQUEST
    if groups.ask_status(s.real_status, (instance, LAST_SUCCESSFUL_TIME, s.value_at)) > 1 or s.varies == 0:
        return np.nan, groups.DO_STEP_FAILED + groups.DISCARD_STATUS
    if not (here - close <= s.value <= goal + close):
        return np.nan, groups.TIME_OUTSIDE_STEP
    return s.value, 0


@njit(cache=True)
def continue_discarded_step(address, ramp, do_step, instance, t, h, final):
    """Continue a discarded step from `t` in parts until `t` + `h`; return 0 or a failure status.

    `address` is of a `DISCARD_RECORD`, `ramp` of a `RAMP_RECORD` with inputs to set for each part (0 if all are held).
    """
    s = carray(_shorter_at(address), 1)[0]
    close = 1e-9 * h
    here, end, part, halved = t, t + h, h, 0
    status = groups.DISCARD_STATUS
    if s.discarded == 0:
        s.since = t
    for _ in range(groups.MAX_PARTS):
        if status == groups.DISCARD_STATUS:
            s.discarded += 1
            reached, bad = _reached_time(s, instance, here, here + part, close)
            if bad != 0:
                return bad
            if reached > here + close:
                part, here, halved = reached - here, reached, 0
            else:
                part, halved = 0.5 * part, halved + 1
                if halved > groups.MAX_HALVINGS:
                    s.value = here
                    return groups.STEP_STUCK
        elif status > 1:
            return groups.DO_STEP_FAILED + status
        else:
            here, part, halved = here + part, 2.0 * part, 0
        if end - here <= close:
            return 0
        part = min(part, end - here)
        if ramp != 0:
            bad = groups.set_ramp(ramp, here)
            if bad != 0:
                return bad
        status = groups.do_step_2(do_step, (instance, here, part, final))
    s.value = here
    return groups.TOO_MANY_PARTS


@njit(cache=True, inline="always")
def _step_2(address, ramp, do_step, instance, t, h, final):
    """Step an FMU of FMI 1.0 or 2.0, in parts if the step is discarded; return 0 or a failure status."""
    status = groups.do_step_2(do_step, (instance, t, h, final))
    if status == groups.DISCARD_STATUS:
        return continue_discarded_step(address, ramp, do_step, instance, t, h, final)
    return groups.failure(groups.DO_STEP_FAILED, status)


@step_function(STEP_MEMORY)
def step(m, t, h, u, y):
    return groups.store_status(m.note, _step(m, t, h, address_of(u), address_of(y)))


@njit(cache=True, inline="always")
def _step(m, t, h, u, y):
    status = groups.set_all(m.version, m.instance, m.input_groups, m.inputs, u)
    if status != 0:
        return status
    if m.version < 3:
        if m.ramp != 0:
            groups.begin_ramp(m.ramp, u, t, h)
            status = groups.set_ramp(m.ramp, t)
            if status != 0:
                return status
        status = _step_2(m.shorter, m.ramp, m.do_step, m.instance, t, h, m.final)
    else:
        # FMI 3.0 FMUs with interpolated inputs use the step with events
        back = m.returned
        status = groups.do_step_3(m.do_step, (m.instance, t, h, m.final, back + 8, back + 9, back + 10, back))
        status = groups.failure(groups.DO_STEP_FAILED, status)
        flags = carray(bytes_at(back), 16)
        if status == 0 and flags[9]:
            return groups.TERMINATE_REQUEST
        if status == 0 and flags[10]:
            return groups.EARLY_RETURN
    if status != 0:
        return status
    return groups.get_all(m.version, m.instance, m.output_groups, m.outputs, y)


@step_function(PLAIN_MEMORY)
def plain_step(m, t, h, u, y):
    # equivalent to `step` for unscaled Real values, with a third of the overhead
    status = groups.failure(
        groups.SET_FAILED, groups.access_2(m.set_real, (m.instance, m.input_references, m.inputs, address_of(u)))
    )
    if status == 0:
        status = _step_2(m.shorter, 0, m.do_step, m.instance, t, h, m.final)
    if status == 0:
        status = groups.access_2(m.get_real, (m.instance, m.output_references, m.outputs, address_of(y)))
        status = groups.failure(groups.GET_FAILED, status)
    if status == 0:
        carray(y, m.outputs)[m.shifted] += m.shift
    return groups.store_status(m.note, status)


@step_function(STATE_MEMORY)
def save(m, t, h, u, y):
    status = groups.call_pointer(m.get, (m.instance, m.cell))
    copy_pieces(m.piece_table, m.pieces, 0, 0)
    return groups.store_status(m.note, groups.failure(groups.SAVE_FAILED, status))


@step_function(STATE_MEMORY)
def restore(m, t, h, u, y):
    status = groups.call_pointer(m.set, (m.instance, m.state))
    copy_pieces(m.piece_table, m.pieces, 0, 1)
    return groups.store_status(m.note, groups.failure(groups.RESTORE_FAILED, status))


@njit(cache=True)
def due_step(address, t, h):
    """Return the number of the step that begins at `t` if an input clock of the FMU ticks there, else -1."""
    e = carray(_events_at(address), 1)[0]
    n = np.int64(np.floor(t / h + 0.5))
    clocks = carray(_clocks_at(e.clock_table), e.clocks)
    for c in range(e.clocks):
        if clocks[c].kind != OUTPUT_CLOCK and clocks[c].next == n:
            return n
    return -1


@njit(cache=True)
def fill_discrete_inputs(address, u):
    """Convert the FMU's discrete inputs at address `u`; return (whether an unclocked one changed, failure status)."""
    e = carray(_events_at(address), 1)[0]
    table = carray(groups.groups_at(e.discrete_groups), e.discrete)
    changed = False
    for i in range(e.discrete):
        g = table[i]
        status = groups.fill(g, u)
        if status != 0:
            return False, status
        new, last = carray(bytes_at(g.buffer), g.bytes), carray(bytes_at(g.last), g.bytes)
        for j in range(g.bytes):
            changed |= g.clocks == 0 and new[j] != last[j]
    return changed, 0


@njit(cache=True)
def _set_discrete(e, active):
    """Set an FMU's discrete inputs (unclocked, or with active clocks) from buffers; return 0 or a failure status."""
    table = carray(groups.groups_at(e.discrete_groups), e.discrete)
    for i in range(e.discrete):
        g = table[i]
        if g.clocks == 0 or g.clocks & active:
            status = groups.access(3, e.instance, g, groups.SET_FAILED)
            if status != 0:
                return status
            copy(g.last, g.buffer, g.bytes)
    return 0


@njit(cache=True)
def _tick(e, clocks, n):
    """Activate the FMU's input clocks due at step `n`; return (bit mask of these clocks, 0 or a failure status)."""
    active = 0
    flag = carray(bytes_at(e.returned + _VALUE_OFFSET), 1)
    for c in range(e.clocks):
        if clocks[c].kind != OUTPUT_CLOCK and clocks[c].next == n:
            flag[0] = 1
            status = groups.access_2(
                e.set_clock, (e.instance, e.clock_table + c * CLOCK_BYTES, 1, e.returned + _VALUE_OFFSET)
            )
            if status > 1:
                return active, groups.SET_CLOCK_FAILED + status
            active |= 1 << c
    return active, 0


@njit(cache=True)
def _active_output_clocks(e, clocks):
    """Query the FMU's active output clocks; return (their bit mask, 0 or a failure status)."""
    active = 0
    flag = carray(bytes_at(e.returned + _VALUE_OFFSET), 1)
    for c in range(e.clocks):
        if clocks[c].kind == OUTPUT_CLOCK:
            flag[0] = 0
            status = groups.access_2(
                e.get_clock, (e.instance, e.clock_table + c * CLOCK_BYTES, 1, e.returned + _VALUE_OFFSET)
            )
            if status > 1:
                return active, groups.GET_CLOCK_FAILED + status
            if flag[0]:
                active |= 1 << c
    return active, 0


@njit(cache=True)
def _read_clocked_outputs(e, active):
    table = carray(groups.groups_at(e.held_groups), e.held)
    for i in range(e.held):
        if table[i].clocks & active:
            status = groups.access(3, e.instance, table[i], groups.GET_FAILED)
            if status != 0:
                return status
    return 0


@njit(cache=True, error_model="numpy")
def _plan_clocks(e, clocks, ticked, n, t):
    """Plan the next ticks of an FMU's clocks at time `t`, where step `n` begins; return 0 or a failure status."""
    answer = carray(_words_at(e.returned + _ANSWER_OFFSET), 1)
    interval = carray(doubles_at(e.returned + _VALUE_OFFSET), 1)
    for c in range(e.clocks):
        kind, done = clocks[c].kind, ticked >> c & 1
        if kind == PERIODIC_CLOCK:
            if done:
                clocks[c].next = n + clocks[c].period
        elif kind == COUNTDOWN_CLOCK or (kind == CHANGING_CLOCK and done):
            if done:
                clocks[c].next = UNKNOWN_STEP
            answer[0], interval[0] = 0, np.nan
            reference = e.clock_table + c * CLOCK_BYTES
            status = groups.access_pairs(
                e.get_interval, (e.instance, reference, 1, e.returned + _VALUE_OFFSET, e.returned + _ANSWER_OFFSET)
            )
            if status > 1:
                return groups.INTERVAL_FAILED + status
            if answer[0] == 2 or (answer[0] == 1 and kind == CHANGING_CLOCK):
                steps = (t + interval[0]) / e.step
                e.value, e.culprit = interval[0], c
                # below 1e9 steps, the tolerance of 1e-6 steps exceeds the rounding of the division
                if not (interval[0] > 0.0 and steps < 1e9 and abs(steps - np.floor(steps + 0.5)) < 1e-6):
                    return groups.INVALID_INTERVAL
                clocks[c].next = np.int64(np.floor(steps + 0.5))
    return 0


@njit(cache=True)
def handle_events(address, n, t):
    """Enter an FMU's event mode at time `t`, handle the event and return to step mode; return 0 or a failure status.

    Discrete inputs are taken from their buffers. `address` is of an `EVENTS_RECORD`, `n` the step that begins at `t`,
    for clocks that tick; -1 if no input clock ticks.
    """
    e = carray(_events_at(address), 1)[0]
    clocks = carray(_clocks_at(e.clock_table), e.clocks)
    status = groups.failure(groups.EVENT_MODE_FAILED, groups.call_instance(e.enter_event_mode, (e.instance,)))
    if status != 0:
        return status
    active, status = _tick(e, clocks, n)
    if status == 0:
        status = _set_discrete(e, active)
    if status == 0:
        status = update_discrete_states(address, active, n, t)
    if status == 0:
        status = groups.failure(groups.STEP_MODE_FAILED, groups.call_instance(e.enter_step_mode, (e.instance,)))
    return status


@entry("int", "int", "int", "int", "double")
def update_discrete_states(address, active, n, t):
    """Update discrete states in event mode, with the clocks `active` (bit mask), until stable; return a status."""
    e = carray(_events_at(address), 1)[0]
    clocks = carray(_clocks_at(e.clock_table), e.clocks)
    flags, next_time = carray(bytes_at(e.returned), 16), carray(doubles_at(e.returned), 1)
    ticked = active
    for _ in range(groups.MAX_UPDATES):
        raised, status = _active_output_clocks(e, clocks)
        if status == 0:
            status = _read_clocked_outputs(e, active | raised)
        if status != 0:
            return status
        for i in range(8, 13):
            flags[i] = 0
        r = e.returned
        status = groups.update_3(e.update, (e.instance, r + 8, r + 9, r + 10, r + 11, r + 12, r))
        if status > 1:
            return groups.UPDATE_FAILED + status
        if flags[9]:
            return groups.TERMINATE_REQUEST
        active = 0
        if not flags[8]:
            break
    else:
        return groups.ENDLESS_UPDATES
    planned = carray(doubles_at(e.next), 1)
    planned[0] = np.inf
    if flags[12]:
        e.value = next_time[0]
        if not next_time[0] > t - 1e-9 * e.step:
            return groups.EVENT_IN_PAST
        planned[0] = next_time[0]
    return _plan_clocks(e, clocks, ticked, n, t)


@njit(cache=True, inline="always")
def _begin_step(m, t, h, u):
    """Handle an FMU's events due at the start of a step and set its inputs; return 0 or a failure status."""
    if m.events != 0:
        n = due_step(m.events, t, h) if m.clocks > 0 else -1
        changed, status = fill_discrete_inputs(m.events, u) if m.discrete > 0 else (False, 0)
        if status != 0:
            return status
        if n >= 0 or changed or carray(doubles_at(m.next), 1)[0] <= t + 1e-9 * h:
            status = handle_events(m.events, n, t)
            if status != 0:
                return status
    status = groups.set_all(3, m.instance, m.input_groups, m.inputs, u)
    if status == 0 and m.ramp != 0:
        groups.begin_ramp(m.ramp, u, t, h)
        status = groups.set_ramp(m.ramp, t)
    return status


@njit(cache=True, inline="always")
def _step_to(m, t, h):
    """Step an FMU from `t` to `t` + `h` in as many parts as events require; return 0 or a failure status."""
    close, here, end = 1e-9 * h, t, t + h
    part, halved, stalls = h, 0, 0
    flags, last = carray(bytes_at(m.returned), 16), carray(doubles_at(m.returned), 1)
    planned = carray(doubles_at(m.next), 1)
    for _ in range(groups.MAX_PARTS):
        goal = end
        if m.varies:
            if here + close < planned[0] < end - close:
                goal = planned[0]
            if goal - here > part:
                goal = here + part
        for i in range(8, 11):
            flags[i] = 0
        r = m.returned
        status = groups.do_step_3(m.do_step, (m.instance, here, goal - here, m.final, r + 8, r + 9, r + 10, r))
        if m.ramp != 0:
            bad = groups.ramp_status(m.ramp)
            if bad != 0:
                return bad
        if status == groups.DISCARD_STATUS and m.varies:
            # the FMU is still at the time before the discarded step
            part, halved, m.value = 0.5 * (goal - here), halved + 1, here
            if halved > groups.MAX_HALVINGS:
                return groups.STEP_STUCK
            continue
        if status > 1:
            return groups.DO_STEP_FAILED + status
        if flags[9]:
            return groups.TERMINATE_REQUEST
        reached = goal
        if flags[10]:
            if not m.early:
                return groups.EARLY_RETURN
            m.value = reached = last[0]
            if not (here - close <= reached <= goal + close):
                return groups.TIME_OUTSIDE_STEP
        part, halved = max(2.0 * part, reached - here), 0
        stalls = stalls + 1 if reached <= here + close else 0
        if stalls > groups.MAX_STALLS:
            m.value = here
            return groups.TIME_STALLED
        here = max(reached, here)
        if m.events != 0 and (flags[8] or planned[0] <= here + close):
            status = handle_events(m.events, -1, here)
            if status != 0:
                return status
        if end - here <= close:
            return 0
        if m.ramp != 0:
            status = groups.set_ramp(m.ramp, here)
            if status != 0:
                return status
    m.value = here
    return groups.TOO_MANY_PARTS


@njit(cache=True, inline="always")
def _get_outputs(m, y):
    held = carray(groups.groups_at(m.held_groups), m.held)
    for i in range(m.held):
        status = groups.drain(held[i], y)
        if status != 0:
            return status
    return groups.get_all(3, m.instance, m.output_groups, m.outputs, y)


@step_function(EVENT_MEMORY)
def event_step(m, t, h, u, y):
    status = _begin_step(m, t, h, address_of(u))
    if status == 0:
        status = _step_to(m, t, h)
    return groups.store_status(m.note, _get_outputs(m, address_of(y)) if status == 0 else status)
