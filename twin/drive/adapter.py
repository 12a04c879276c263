"""One compiled step for every co-simulation FMU without events: set inputs, step, get outputs, all by address.

Variables travel in groups of one FMI type. A group holds where its values stand among the component's inputs or
outputs, how they are scaled (contract value = gain * FMU value + offset), and a buffer of the FMI type.
"""

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.cosim.native import address_of, step_function
from twin.drive.calls import access_2, access_3, do_step_2, do_step_3
from twin.drive.ramp import begin_ramp, set_ramp
from twin.drive.shorter import go_on
from twin.drive.status import DISCARD, DO_STEP, EARLY, GET, SET, TERMINATE

_f64, _f32 = pointer_to(np.float64), pointer_to(np.float32)
_i8, _u8, _i16, _u16 = (pointer_to(t) for t in (np.int8, np.uint8, np.int16, np.uint16))
_i32, _u32, _i64, _u64 = (pointer_to(t) for t in (np.int32, np.uint32, np.int64, np.uint64))

GROUP = np.dtype(
    [
        ("kind", "i8"),
        ("access", "i8"),
        ("references", "i8"),
        ("variables", "i8"),
        ("values", "i8"),
        ("slots", "i8"),
        ("gain", "i8"),
        ("offset", "i8"),
        ("buffer", "i8"),
        ("bytes", "i8"),
        ("last", "i8"),
        ("clocks", "i8"),
    ],
    align=True,
)
"""A group: index into KINDS; address of fmiNSetType or fmiNGetType; addresses and counts: `variables` value references
(uint32), `values` slots (uint64) into u or y, gains and offsets (float64), and the buffer, of so many
bytes. Arrays make values exceed variables. With events also: `last`, what inputs were last set to, and the clocks with
which alone the group changes, a bit for each."""

MEMORY = np.dtype(
    [
        ("version", "i8"),
        ("instance", "i8"),
        ("do_step", "i8"),
        ("final", "i8"),
        ("inputs", "i8"),
        ("input_groups", "i8"),
        ("outputs", "i8"),
        ("output_groups", "i8"),
        ("returned", "i8"),
        ("ramp", "i8"),
        ("shorter", "i8"),
    ],
    align=True,
)
"""Addresses of instance and function, counts and addresses of groups; 16 bytes for what fmi3DoStep returns; addresses
of what `ramp` and `shorter` work on, 0 where nothing is done within a step."""

groups_at = pointer_to(GROUP)


@njit(cache=True)
def _store(kind, buffer, j, value):
    """Put `value` at place `j` of a buffer of FMI type `kind`; whole numbers are rounded to the nearest."""
    if kind == 0:
        carray(_f64(buffer), j + 1)[j] = value
    elif kind == 1:
        carray(_f32(buffer), j + 1)[j] = value
    elif kind == 10:
        carray(_u8(buffer), j + 1)[j] = 1 if value > 0.5 else 0
    else:
        whole = np.int64(np.floor(value + 0.5))
        if kind == 2:
            carray(_i8(buffer), j + 1)[j] = whole
        elif kind == 3:
            carray(_u8(buffer), j + 1)[j] = whole
        elif kind == 4:
            carray(_i16(buffer), j + 1)[j] = whole
        elif kind == 5:
            carray(_u16(buffer), j + 1)[j] = whole
        elif kind == 6:
            carray(_i32(buffer), j + 1)[j] = whole
        elif kind == 7:
            carray(_u32(buffer), j + 1)[j] = whole
        elif kind == 8:
            carray(_i64(buffer), j + 1)[j] = whole
        else:
            carray(_u64(buffer), j + 1)[j] = whole


@njit(cache=True)
def _load(kind, buffer, j):
    """The value at place `j` of a buffer of FMI type `kind`."""
    if kind == 0:
        return carray(_f64(buffer), j + 1)[j]
    if kind == 1:
        return np.float64(carray(_f32(buffer), j + 1)[j])
    if kind == 2:
        return np.float64(carray(_i8(buffer), j + 1)[j])
    if kind == 3 or kind == 10:
        return np.float64(carray(_u8(buffer), j + 1)[j])
    if kind == 4:
        return np.float64(carray(_i16(buffer), j + 1)[j])
    if kind == 5:
        return np.float64(carray(_u16(buffer), j + 1)[j])
    if kind == 6:
        return np.float64(carray(_i32(buffer), j + 1)[j])
    if kind == 7:
        return np.float64(carray(_u32(buffer), j + 1)[j])
    if kind == 8:
        return np.float64(carray(_i64(buffer), j + 1)[j])
    return np.float64(carray(_u64(buffer), j + 1)[j])


@njit(cache=True, inline="always")
def access(version, instance, g):
    """Set or get the variables of a group."""
    if version < 3:
        return access_2(g.access, instance, g.references, g.variables, g.buffer)
    return access_3(g.access, instance, g.references, g.variables, g.buffer, g.values)


@njit(cache=True, inline="always")
def fill(g, u):
    """Put the inputs at address `u` into the buffer of a group."""
    slots, gain, offset = (
        carray(_u64(g.slots), g.values),
        carray(_f64(g.gain), g.values),
        carray(_f64(g.offset), g.values),
    )
    for j in range(g.values):
        _store(g.kind, g.buffer, j, (carray(_f64(u), slots[j] + 1)[slots[j]] - offset[j]) / gain[j])


@njit(cache=True, inline="always")
def drain(g, y):
    """Take what is in the buffer of a group to the outputs at address `y`."""
    slots, gain, offset = (
        carray(_u64(g.slots), g.values),
        carray(_f64(g.gain), g.values),
        carray(_f64(g.offset), g.values),
    )
    for j in range(g.values):
        carray(_f64(y), slots[j] + 1)[slots[j]] = gain[j] * _load(g.kind, g.buffer, j) + offset[j]


@njit(cache=True, inline="always")
def set_all(version, instance, groups, count, u):
    """Set the inputs of `count` groups; the first bad status."""
    table = carray(groups_at(groups), count)
    for i in range(count):
        fill(table[i], u)
        status = access(version, instance, table[i])
        if status > 1:
            return SET + status
    return 0


@njit(cache=True, inline="always")
def get_all(version, instance, groups, count, y):
    """Get the outputs of `count` groups; the first bad status."""
    table = carray(groups_at(groups), count)
    for i in range(count):
        status = access(version, instance, table[i])
        if status > 1:
            return GET + status
        drain(table[i], y)
    return 0


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
        status = do_step_2(m.do_step, m.instance, t, h, m.final)
        if status == DISCARD:
            status = go_on(m.shorter, m.ramp, m.do_step, m.instance, t, h, m.final)
            if status != 0:
                return status
    else:
        # an FMU of 3.0 that takes lines is stepped as one with events
        status = do_step_3(m.do_step, m.instance, t, h, m.final, m.returned)
        if status <= 1:
            flags = carray(_u8(m.returned), 16)
            if flags[9]:
                return TERMINATE
            if flags[10]:
                return EARLY
    if status > 1:
        return DO_STEP + status
    return get_all(m.version, m.instance, m.output_groups, m.outputs, address_of(y))
