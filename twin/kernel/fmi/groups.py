"""Access to FMU variables by address: in groups of one type, or interpolated over a step.

A group contains the positions of its values among the component's inputs or outputs, their scaling (port value = gain *
FMU value + offset), and a buffer of the FMI type. An interpolated input has two port values, at the start and the end
of a step. FMI 1.0 and 2.0 take the value at the start and the slope (fmi2SetRealInputDerivatives). FMI 3.0 requests
the value at every time its solver evaluates (fmi3IntermediateUpdateCallback).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from twin.kernel.compiled.function import c, carray, njit, pointer_to
from twin.kernel.compiled.native import Native
from twin.kernel.cosim.component import address_of, c_function, doubles_at, integers_at
from twin.kernel.cosim.port import record
from twin.kernel.fmi.variable import HIGHEST_VALUES, LOWEST_VALUES, MAX_EXACT
from twin.kernel.hooks import HOOKS

INVALID_STATUS, STATUS_WIDTH = 15, 16
"""Code of an integer outside the statuses of every FMI version, and the bit at which that integer is stored."""
SET_FAILED, DO_STEP_FAILED, GET_FAILED, TERMINATE_REQUEST, SAVE_FAILED, RESTORE_FAILED = 16, 32, 48, 64, 80, 96
(
    EVENT_MODE_FAILED,
    UPDATE_FAILED,
    STEP_MODE_FAILED,
    SET_CLOCK_FAILED,
    GET_CLOCK_FAILED,
    INTERVAL_FAILED,
    INPUT_DERIVATIVES_FAILED,
) = 256, 272, 288, 304, 320, 336, 352
"""Failure statuses: base per function, plus the returned FMI status."""
(
    EARLY_RETURN,
    TIME_OUTSIDE_STEP,
    TIME_STALLED,
    TOO_MANY_PARTS,
    ENDLESS_UPDATES,
    EVENT_IN_PAST,
    INVALID_INTERVAL,
    STEP_STUCK,
) = 512, 513, 514, 515, 516, 517, 518, 519
"""Failure statuses for violations that no FMI function reports."""
INPUT_OUT_OF_RANGE, INEXACT_OUTPUT = 520, 521
"""Failure statuses of values: an input outside the range of its type, an output integer beyond `MAX_EXACT`."""
BOOLEAN_KIND, BOOLEAN_32_KIND = 10, 11
"""Kinds of groups: index of Boolean in `NUMERIC_TYPES`, one byte; Boolean of FMI 2.0, four bytes."""
DISCARD_STATUS, PENDING_STATUS = 2, 5
STATUS_NAMES = {2: "Discard", 3: "Error", 4: "Fatal", PENDING_STATUS: "Pending"}
MAX_HALVINGS = 10
"""Maximum number of successive halvings of a step without progress; beyond it, the FMU is stuck."""
MAX_PARTS = 10_000
MAX_STALLS = 100
"""Maximum number of events and early returns at one time."""
MAX_UPDATES = 1000
"""Maximum number of updates of discrete states in an event."""
FUNCTION_NAMES = {
    SET_FAILED: "Set", DO_STEP_FAILED: "DoStep", GET_FAILED: "Get",
    EVENT_MODE_FAILED: "EnterEventMode", UPDATE_FAILED: "UpdateDiscreteStates", STEP_MODE_FAILED: "EnterStepMode",
    SET_CLOCK_FAILED: "SetClock", GET_CLOCK_FAILED: "GetClock", INTERVAL_FAILED: "GetIntervalDecimal",
    INPUT_DERIVATIVES_FAILED: "SetRealInputDerivatives",
}  # fmt: skip
NOTE_RECORD = record(
    status="i8",  # invalid status that a function returned, shifted right by `STATUS_WIDTH` bits
    # slot among inputs or outputs of a value that is INPUT_OUT_OF_RANGE or INEXACT_OUTPUT, or of a failed call
    slot="i8",
    value="f8",  # value that is out of range
    whole="i8",  # integer that is inexact
)
"""Details of a failure status beyond the return value of a step, one record per instance."""
GROUP_RECORD = record(
    kind="i8",  # index into `NUMERIC_TYPES`
    access="i8",  # address of fmiNSetType or fmiNGetType
    references="i8",  # address of value references (uint32)
    variables="i8",  # number of variables
    values="i8",  # number of values; more than variables if there are arrays
    slots="i8",  # address of slots in u or y (uint64)
    gain="i8",  # address of gains (float64)
    offset="i8",  # address of offsets (float64)
    buffer="i8",  # address of values in the FMI type
    bytes="i8",  # size of the buffer
    last="i8",  # with events: address of the last input values set
    clocks="i8",  # with events: bit mask of the clocks at whose ticks alone the group changes
    items="i8",  # of an enumeration: number of its values
    item_values="i8",  # of an enumeration: address of its values (float64)
    note="i8",  # address of a `NOTE_RECORD`
)
"""Group of variables of one FMI type: counts, and addresses of functions and arrays."""
END_SUFFIX = ":end"
"""Suffix of the port for the value of an input at the end of a step."""
RAMP_RECORD = record(
    instance="i8",
    set="i8",  # fmiNSetReal or fmi3SetFloat64
    derivatives="i8",  # fmiNSetRealInputDerivatives; 0 in FMI 3.0
    values="i8",  # number of values
    references="i8",
    orders="i8",  # orders of the derivatives, all 1
    starts="i8",  # slots in u of the values at the start of a step
    ends="i8",  # slots in u of the values at its end
    gain="i8",
    offset="i8",
    begin="i8",  # values at the start, in the FMU's unit
    slope="i8",
    buffer="i8",
    t="f8",  # start of the step (s)
    bad="i8",  # failure status within the step
    note="i8",  # address of a `NOTE_RECORD`
)
"""Inputs interpolated over a step: counts, and addresses of functions and of arrays with a number for each value."""
_f64, _f32 = pointer_to(np.float64), pointer_to(np.float32)
_i8, _u8, _i16, _u16 = (pointer_to(t) for t in (np.int8, np.uint8, np.int16, np.uint16))
_i32, _u32, _i64, _u64 = (pointer_to(t) for t in (np.int32, np.uint32, np.int64, np.uint64))
note_at, groups_at, _ramp_at = pointer_to(NOTE_RECORD), pointer_to(GROUP_RECORD), pointer_to(RAMP_RECORD)


@contextmanager
def announce_call(file: str, instance: str, function: str) -> Iterator[None]:
    """Call the hooks `HOOKS.fmi_call` before and after the block, a call of the FMI function `function`."""
    for hook in HOOKS.fmi_call:
        hook(file, instance, function)
    try:
        yield
    finally:
        for hook in HOOKS.fmi_call:
            hook(file, instance, "")


def _wide_status(builder, returned):
    wide = builder.zext(returned, c.i64)
    other = builder.or_(builder.shl(wide, c.i64(STATUS_WIDTH)), c.i64(INVALID_STATUS))
    return builder.select(builder.icmp_unsigned(">", returned, c.i32(5)), other, wide)


def fmi_function(*kinds: str) -> Any:
    """Create a function for compiled code that calls the FMI function at an address, see `c_function`.

    It returns statuses 0 .. 5 unchanged, others as `INVALID_STATUS` + (unsigned status << `STATUS_WIDTH`).
    """
    return c_function("int", *kinds, convert=_wide_status)


access_2 = fmi_function("pointer", "pointer", "size", "pointer")
"""`fmi2SetX|fmi2GetX(c, vr, nvr, values)`, their equivalents in FMI 1.0, `fmi3SetClock|fmi3GetClock`."""
access_3 = fmi_function("pointer", "pointer", "size", "pointer", "size")
"""`fmi3SetX|fmi3GetX(instance, vr, nvr, values, nValues)`."""
access_pairs = fmi_function("pointer", "pointer", "size", "pointer", "pointer")
"""`fmi2SetRealInputDerivatives(c, vr, nvr, orders, values)`, `fmi3GetIntervalDecimal(.., intervals, qualifiers)`."""
do_step_2 = fmi_function("pointer", "double", "double", "int")
"""`fmi2DoStep(c, t, h, final)`; `final`: no state before `t` will be restored.

In FMI 1.0 the last argument is a char that marks a new step; it is passed in the same way.
"""
do_step_3 = fmi_function("pointer", "double", "double", "byte", "pointer", "pointer", "pointer", "pointer")
"""`fmi3DoStep(instance, t, h, final, &event, &terminate, &early, &lastTime)`."""
ask_status = fmi_function("pointer", "int", "pointer")
"""`fmi2GetRealStatus|fmi2GetBooleanStatus(c, kind, value)`."""
call_instance = fmi_function("pointer")
"""`fmiNEnterEventMode(c)`, `fmi3EnterStepMode(c)`, `fmiNEnterContinuousTimeMode(c)`."""
update_3 = fmi_function("pointer", "pointer", "pointer", "pointer", "pointer", "pointer", "pointer")
"""`fmi3UpdateDiscreteStates(c, five flags, next time)`."""
call_pointer = fmi_function("pointer", "pointer")
"""`fmiNGetFMUState(c, state)`, `fmi2NewDiscreteStates(c, info)`, `fmi3GetNumberOfContinuousStates(c, n)`."""
call_time = fmi_function("pointer", "double")
"""`fmiNSetTime(c, t)`, `CVodeSetStopTime(memory, t)`."""
call_doubles = fmi_function("pointer", "pointer", "size")
"""`fmiNSetContinuousStates(c, x, n)` and all other functions of states, derivatives and event indicators."""
completed_2 = fmi_function("pointer", "int", "pointer", "pointer")
completed_3 = fmi_function("pointer", "byte", "pointer", "pointer")
"""`fmiNCompletedIntegratorStep(c, noSetFMUStatePriorToCurrentPoint, enterEventMode, terminateSimulation)`."""
start_at = fmi_function("pointer", "double", "pointer")
"""`CVodeReInit(memory, t, x)`, `CVodeSVtolerances(memory, relative, absolute)`."""
one_step = c_function("int", "pointer", "double", "pointer", "pointer", "int")
"""`CVode(memory, t_out, x, t_reached, task)`."""
values_of = c_function("pointer", "pointer")
"""`N_VGetArrayPointer(vector)`."""


def status_phrase(function: str, status: int) -> str:
    """Describe a bad status of an FMI function: `fmi2DoStep returned fmi2Error`."""
    # FMI 3.0 has no Pending; in FMI 1.0 and 2.0 only doStep may return it
    if status in STATUS_NAMES and (status != PENDING_STATUS or function in ("fmiDoStep", "fmi2DoStep")):
        prefix = function[:4] if function[3:4].isdigit() else "fmi"
        return f"{function} returned {prefix}{STATUS_NAMES[status]}"
    return f"{function} returned {status}, which is not a status of FMI"


def explain_status(
    status: int, prefix: str, functions: dict[int, str], value: float, clock: str, message: str, other: int = 0
) -> str:
    """Describe a failure status of an FMU's step, as a verb phrase for an error message.

    `functions` has further names by base of the status, `value` the time or interval (s) that the FMU returned with it,
    `message` its last log message, `other` a status outside the standard.
    """
    step, update = f"{prefix}DoStep", f"{prefix}UpdateDiscreteStates"
    sentences = {
        TERMINATE_REQUEST: f"{step} asked to terminate the simulation{message}",
        EARLY_RETURN: f"{step} returned early, which its description does not permit{message}; export it again",
        TIME_OUTSIDE_STEP: f"{step} reports that it stepped until t = {value:.9g} s, which lies outside of this step"
        f"{message}",
        TIME_STALLED: f"{step} stays at t = {value:.9g} s{message}: more than {MAX_STALLS} events or early returns "
        "there",
        STEP_STUCK: f"{step} returned {prefix}Discard{message} and stays at t = {value:.9g} s, however short its steps",
        TOO_MANY_PARTS: f"{step} takes more than {MAX_PARTS} parts for this step, and is at t = {value:.9g} s{message}",
        ENDLESS_UPDATES: f"{update} wants to be called for ever: more than {MAX_UPDATES} times in one event{message}",
        EVENT_IN_PAST: f"{update} plans its next event for t = {value:.9g} s, which has passed or is no time{message}",
        INVALID_INTERVAL: f"{prefix}GetIntervalDecimal reports that clock '{clock}' ticks after {value:.9g} s{message}"
        "; expected a whole number of steps: choose a tick or substeps that fit",
    }
    if status in sentences:
        return sentences[status]
    called = (FUNCTION_NAMES | functions)[status // 16 * 16]
    return status_phrase(f"{prefix}{called}", other if status % 16 == INVALID_STATUS else status % 16) + message


@njit(cache=True, inline="always")
def failure(base, status):
    """Return the failure status `base` + `status` of an FMI function that returned `status`; 0 for OK and warnings."""
    return base + status if status > 1 else 0


@njit(cache=True, inline="always")
def store_status(note, status):
    """Return the lowest `STATUS_WIDTH` bits of a status, and note the others for the error message."""
    if status >> STATUS_WIDTH != 0:
        carray(note_at(note), 1)[0].status = status >> STATUS_WIDTH
    return status & (1 << STATUS_WIDTH) - 1


@njit(cache=True)
def _store(kind, buffer, j, value):
    """Store a number at index `j` of a buffer of FMI type `kind`, integers rounded; return whether it is in range."""
    # doubles from MAX_EXACT / 2 on are integers, and adding a half to them would round
    if kind >= 2 and abs(value) < MAX_EXACT // 2:
        value = np.floor(value + 0.5)
    if not LOWEST_VALUES[kind] <= value <= HIGHEST_VALUES[kind]:
        return False
    if kind == 0:
        carray(_f64(buffer), j + 1)[j] = value
    elif kind == 1:
        carray(_f32(buffer), j + 1)[j] = value
    else:
        # signed and unsigned integers of a size have the same bits
        whole = np.int64(value)
        if kind == 2 or kind == 3 or kind == BOOLEAN_KIND:
            carray(_i8(buffer), j + 1)[j] = whole
        elif kind == 4 or kind == 5:
            carray(_i16(buffer), j + 1)[j] = whole
        elif kind == 8 or kind == 9:
            carray(_i64(buffer), j + 1)[j] = whole
        else:
            carray(_i32(buffer), j + 1)[j] = whole
    return True


@njit(cache=True)
def _load(kind, buffer, j):
    if kind == 0:
        return carray(_f64(buffer), j + 1)[j]
    if kind == 1:
        return np.float64(carray(_f32(buffer), j + 1)[j])
    if kind == 2:
        return np.float64(carray(_i8(buffer), j + 1)[j])
    if kind == 3 or kind == BOOLEAN_KIND:
        return np.float64(carray(_u8(buffer), j + 1)[j])
    if kind == 4:
        return np.float64(carray(_i16(buffer), j + 1)[j])
    if kind == 5:
        return np.float64(carray(_u16(buffer), j + 1)[j])
    if kind == 6 or kind == BOOLEAN_32_KIND:
        return np.float64(carray(_i32(buffer), j + 1)[j])
    if kind == 7:
        return np.float64(carray(_u32(buffer), j + 1)[j])
    if kind == 8:
        return np.float64(carray(_i64(buffer), j + 1)[j])
    return np.float64(carray(_u64(buffer), j + 1)[j])


@njit(cache=True, inline="always")
def access(version, instance, g, base):
    """Set or get a group of FMU variables with one call of its FMI function; return 0 or a failure status with `base`.

    After a failure the group's first variable is noted for the error message.
    """
    if version < 3:
        status = access_2(g.access, (instance, g.references, g.variables, g.buffer))
    else:
        status = access_3(g.access, (instance, g.references, g.variables, g.buffer, g.values))
    if status > 1:
        carray(note_at(g.note), 1)[0].slot = carray(_u64(g.slots), 1)[0]
    return failure(base, status)


@njit(cache=True, inline="always")
def _scaling(g):
    return carray(_u64(g.slots), g.values), carray(_f64(g.gain), g.values), carray(_f64(g.offset), g.values)


@njit(cache=True)
def _is_item(g, j):
    """Whether the value at index `j` of an enumeration group's buffer is a value of the enumeration."""
    value, found = _load(g.kind, g.buffer, j), False
    for item in carray(doubles_at(g.item_values), g.items):
        found |= item == value
    return found


@njit(cache=True, inline="always")
def fill(g, u):
    """Convert component inputs at address `u` to FMU values in a group's buffer; return 0 or `INPUT_OUT_OF_RANGE`."""
    slots, gain, offset = _scaling(g)
    for j in range(g.values):
        value = (carray(_f64(u), slots[j] + 1)[slots[j]] - offset[j]) / gain[j]
        if not _store(g.kind, g.buffer, j, value) or (g.items != 0 and not _is_item(g, j)):
            note = carray(note_at(g.note), 1)[0]
            note.slot, note.value = slots[j], value
            return INPUT_OUT_OF_RANGE
    return 0


@njit(cache=True, inline="always")
def drain(g, y):
    """Convert FMU values in a group's buffer to component outputs at address `y`; return 0 or `INEXACT_OUTPUT`."""
    slots, gain, offset = _scaling(g)
    for j in range(g.values):
        if g.kind == 8 or g.kind == 9:
            whole = carray(_i64(g.buffer), j + 1)[j]
            # a UInt64 beyond the range of Int64 is negative here
            if not (0 if g.kind == 9 else -MAX_EXACT) <= whole <= MAX_EXACT:
                note = carray(note_at(g.note), 1)[0]
                note.slot, note.whole = slots[j], whole
                return INEXACT_OUTPUT
        carray(_f64(y), slots[j] + 1)[slots[j]] = gain[j] * _load(g.kind, g.buffer, j) + offset[j]
    return 0


@njit(cache=True, inline="always")
def set_all(version, instance, groups, count, u):
    """Set the FMU's inputs in `count` groups from address `u`; return 0 or the first failure status."""
    table = carray(groups_at(groups), count)
    for i in range(count):
        status = fill(table[i], u)
        if status == 0:
            status = access(version, instance, table[i], SET_FAILED)
        if status != 0:
            return status
    return 0


@njit(cache=True, inline="always")
def get_all(version, instance, groups, count, y):
    """Get the FMU's outputs in `count` groups to address `y`; return 0 or the first failure status."""
    table = carray(groups_at(groups), count)
    for i in range(count):
        status = access(version, instance, table[i], GET_FAILED)
        if status == 0:
            status = drain(table[i], y)
        if status != 0:
            return status
    return 0


@njit(cache=True, error_model="numpy")
def begin_ramp(address, u, t, h):
    """Compute start values and slopes of the FMU inputs that are interpolated linearly from `t` to `t` + `h`."""
    r = carray(_ramp_at(address), 1)[0]
    n = r.values
    starts, ends = carray(integers_at(r.starts), n), carray(integers_at(r.ends), n)
    gain, offset = carray(doubles_at(r.gain), n), carray(doubles_at(r.offset), n)
    begin, slope = carray(doubles_at(r.begin), n), carray(doubles_at(r.slope), n)
    for j in range(n):
        first, last = carray(doubles_at(u), starts[j] + 1)[starts[j]], carray(doubles_at(u), ends[j] + 1)[ends[j]]
        begin[j] = (first - offset[j]) / gain[j]
        slope[j] = (last - first) / gain[j] / h
    r.t, r.bad = t, 0


@njit(cache=True)
def set_ramp(address, t):
    """Set the FMU's interpolated inputs (derivatives too in FMI 1.0, 2.0) at `t`; return 0 or the first bad status."""
    r = carray(_ramp_at(address), 1)[0]
    n = r.values
    if n == 0:
        return 0
    begin, slope = carray(doubles_at(r.begin), n), carray(doubles_at(r.slope), n)
    buffer, note = carray(doubles_at(r.buffer), n), carray(note_at(r.note), 1)[0]
    note.slot = carray(integers_at(r.starts), n)[0]
    for j in range(n):
        buffer[j] = begin[j] + slope[j] * (t - r.t)
        if not np.isfinite(buffer[j]):
            note.slot, note.value = carray(integers_at(r.starts), n)[j], buffer[j]
            return INPUT_OUT_OF_RANGE
    if r.derivatives == 0:
        return failure(SET_FAILED, access_3(r.set, (r.instance, r.references, n, r.buffer, n)))
    status = failure(SET_FAILED, access_2(r.set, (r.instance, r.references, n, r.buffer)))
    if status != 0:
        return status
    status = access_pairs(r.derivatives, (r.instance, r.references, n, r.orders, r.slope))
    return failure(INPUT_DERIVATIVES_FAILED, status)


@njit(cache=True)
def ramp_status(address):
    """Return the failure status of an FMU's requests for interpolated inputs within a step; 0 without failures."""
    return carray(_ramp_at(address), 1)[0].bad


def _intermediate_update(
    environment, t, set_requested, get_allowed, finished, can_return_early, return_early, return_time
):
    address = address_of(environment)
    r = carray(_ramp_at(address), 1)[0]
    status = 0
    # before the first step the record is empty
    if set_requested and r.values > 0:
        status = set_ramp(address, t)
    if status != 0:
        r.bad = status
    if address_of(return_early) != 0:
        return_early[0] = 0


intermediate_update = Native(
    "nothing",
    ("pointer", "double", "byte", "byte", "byte", "byte", "bytes", "doubles"),
    _intermediate_update,
)
"""Compiled fmi3IntermediateUpdateCallback; its environment is the address of a `RAMP_RECORD`."""
