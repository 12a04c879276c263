"""Inputs that rise within a step: by derivatives (FMI 1.0 and 2.0), or set anew at intermediate times (FMI 3.0).

The component sees such an input at both ends of a step. FMI 1.0 and 2.0 take the value at its start and the slope
(fmi2SetRealInputDerivatives); FMI 3.0 asks for the value whenever its solver is at another time
(fmi3IntermediateUpdateCallback).
"""

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.compiled.native import Native
from twin.cosim.native import address_of, doubles_at, integers_at
from twin.drive.calls import access_2, access_3, access_pairs
from twin.drive.status import DERIVATIVES, SET

AT_END = ":end"
"""What the port for the value at the end of a step is called after its input's name."""

RAMP = np.dtype(
    [
        ("instance", "i8"),
        ("set", "i8"),
        ("derivatives", "i8"),
        ("values", "i8"),
        ("references", "i8"),
        ("orders", "i8"),
        ("starts", "i8"),
        ("ends", "i8"),
        ("gain", "i8"),
        ("offset", "i8"),
        ("begin", "i8"),
        ("slope", "i8"),
        ("buffer", "i8"),
        ("t", "f8"),
        ("bad", "i8"),
    ],
    align=True,
)
"""Addresses of instance, of fmiNSetReal or fmi3SetFloat64 and of fmiNSetRealInputDerivatives (0 in FMI 3.0); how many
values, and addresses of their references, orders (1), slots in u at both ends, gains and offsets, value at the start,
slope and buffer; time of the start; what was bad within a step."""

_ramp_at = pointer_to(RAMP)


@njit(cache=True, error_model="numpy")
def begin_ramp(address, u, t, h):
    """Take over what the inputs at address `u` are at both ends of the step from `t` to `t` + `h`."""
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
    """Set the inputs as they are at `t`, and how they go on from there; the first bad status."""
    r = carray(_ramp_at(address), 1)[0]
    n = r.values
    if n == 0:
        return 0
    begin, slope = carray(doubles_at(r.begin), n), carray(doubles_at(r.slope), n)
    buffer = carray(doubles_at(r.buffer), n)
    for j in range(n):
        buffer[j] = begin[j] + slope[j] * (t - r.t)
    if r.derivatives == 0:
        status = access_3(r.set, r.instance, r.references, n, r.buffer, n)
        return SET + status if status > 1 else 0
    status = access_2(r.set, r.instance, r.references, n, r.buffer)
    if status > 1:
        return SET + status
    status = access_pairs(r.derivatives, r.instance, r.references, n, r.orders, r.slope)
    return DERIVATIVES + status if status > 1 else 0


@njit(cache=True)
def bad_ramp(address):
    """What was bad when the FMU asked for its inputs within a step; 0: nothing."""
    return carray(_ramp_at(address), 1)[0].bad


def _intermediate_update(
    environment, t, set_requested, get_allowed, finished, can_return_early, return_early, return_time
):
    address = address_of(environment)
    r = carray(_ramp_at(address), 1)[0]
    status = 0
    # before the first step there is nothing to be set
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
"""A fmi3IntermediateUpdateCallback whose environment is the address of a `RAMP`."""
