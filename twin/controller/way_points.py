"""The pre-defined way as a component of its own, for a controller that does not bring one."""

from collections.abc import Sequence

import numpy as np

from twin.compiled.function import carray
from twin.controller.controller import OUTPUTS as CONTROLLER_OUTPUTS
from twin.controller.controller import reference_position
from twin.cosim.component import NativeComponent
from twin.cosim.native import doubles_at, step_function
from twin.cosim.port import record

P_REF_B = next(port for port in CONTROLLER_OUTPUTS if port.name == "p_ref_B")
MEMORY = record(segment="i8", way_points="i8", times="i8", points="i8")


@step_function(MEMORY, outputs=(P_REF_B,))
def step(m, t, h, u, y):
    times, points = carray(doubles_at(m.times), m.way_points), carray(doubles_at(m.points), (m.way_points, 3))
    p = y.p_ref_B
    p[0], p[1], p[2], m.segment = reference_position(times, points, m.segment, t)
    return 0


class WayPointReference(NativeComponent):
    """Sampled component: the point of the trajectory at t_k.

    Args:
        times, points: way points, (n,) s ascending and (n, 3) m.
        period: in ticks.
    """

    def __init__(self, times: Sequence[float], points: Sequence[Sequence[float]], period: int = 1):
        kept = np.array(times, dtype=float), np.array(points, dtype=float)
        memory = np.array([(0, len(kept[0]), kept[0].ctypes.data, kept[1].ctypes.data)], dtype=MEMORY)
        super().__init__("reference", (), (P_REF_B,), True, step, memory, period=period, keep=kept)
