"""The plant outside a co-simulation: its equations for Python, and its start in an exported FMU.

Right-hand side and outputs are the component's own functions, without further physics here. The surface is at rest in
the equations for Python.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import step_function
from twin.kernel.cosim.port import Port, memory_of, record
from twin.robot.mechanism.kinematics import jacobian_row, leg_angle
from twin.robot.mechanism.statics import platform_weight
from twin.robot.plant.component import (
    LEFT_WORKSPACE,
    NO_MOTION,
    OUTPUTS_RECORD,
    PLANT_MEMORY,
    PLANT_OUTPUTS,
    outputs_near,
    plant_inputs,
    settle,
    triple,
)
from twin.robot.plant.contact import apex_frame, contact_force
from twin.robot.plant.dynamics import (
    INITIAL_ANCHORS,
    PARAMETERS_RECORD,
    STATE_SIZE,
    PlantParameters,
    derivative_near,
    joint_torque,
    series_share,
    settle_friction,
)
from twin.robot.plant.joints import ANCHOR_SIZE, arm_torque, inverse_stop_deflection, stop_torque, upward

_EQUATIONS_RECORD = record(
    parameters=PARAMETERS_RECORD,
    x=("f8", (STATE_SIZE,)),
    theta_m="3f8",
    anchors=("f8", (3, ANCHOR_SIZE)),
    dx=("f8", (STATE_SIZE,)),
)
"""State, motor angles (rad), anchors of dry friction, derivative."""
REST_OUTPUTS = (
    Port("theta_m_rest", 3, "rad", "motor angles at which the platform rests where it starts, to rounding"),
)


@entry("nothing", _EQUATIONS_RECORD)
def _derive(m):
    derivative_near(m.parameters, m.x, m.theta_m, NO_MOTION, NO_MOTION, m.anchors, m.dx)


@entry("nothing", _EQUATIONS_RECORD, OUTPUTS_RECORD)
def _read_outputs(m, y):
    outputs_near(m.parameters, m.x, m.theta_m, NO_MOTION, NO_MOTION, apex_frame(m.parameters), m.anchors, y)


@entry("nothing", _EQUATIONS_RECORD)
def _hold(m):
    settle_friction(m.parameters, m.x, m.theta_m, m.anchors)


@entry("nothing", _EQUATIONS_RECORD)
def _settle_at(m):
    settle(m.parameters, apex_frame(m.parameters), m.x, NO_MOTION, NO_MOTION)


class PlantEquations:
    """The plant's differential equations outside a co-simulation, for given true parameters."""

    def __init__(self, parameters: PlantParameters):
        self._at = memory_of(_EQUATIONS_RECORD, parameters=tuple(parameters), anchors=INITIAL_ANCHORS)

    def hold(self, x: ArrayLike, theta_m: ArrayLike) -> None:
        """Anchor the dry friction at a state (8,) and motor angles (3,) in rad, replacing earlier anchors."""
        self._set_state(x, theta_m)
        self._at["anchors"] = INITIAL_ANCHORS
        _hold(self._at)

    def derivative(self, x: ArrayLike, theta_m: ArrayLike) -> NDArray[np.float64]:
        """Return the derivative dx/dt (8,) of the plant's state; NaN outside the workspace."""
        self._set_state(x, theta_m)
        _derive(self._at)
        dx: NDArray[np.float64] = self._at["dx"][0].copy()
        return dx

    def outputs(self, x: ArrayLike, theta_m: ArrayLike) -> np.ndarray:
        """Return the plant's outputs (1,), a record of `OUTPUTS_RECORD`, with dry friction at rest."""
        self._set_state(x, theta_m)
        self._at["anchors"] = INITIAL_ANCHORS
        y = np.empty(1, dtype=OUTPUTS_RECORD)
        _read_outputs(self._at, y)
        return y

    def settle_bristle(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return the plant's state with its friction bristle scaled back onto the friction cone."""
        self._at["x"] = x
        _settle_at(self._at)
        settled: NDArray[np.float64] = self._at["x"][0].copy()
        return settled

    def _set_state(self, x: ArrayLike, theta_m: ArrayLike) -> None:
        self._at["x"], self._at["theta_m"] = x, theta_m


@cache
def outputs_at_start(moving, ramp):
    """Compile the function that computes an exported plant's outputs before its first step."""

    @step_function(PLANT_MEMORY, plant_inputs(moving, ramp), PLANT_OUTPUTS)
    def start(m, t, h, u, y):
        # the old anchors do not fit a new pose
        for leg in range(3):
            for i in range(ANCHOR_SIZE):
                m.anchors[leg, i] = math.nan
        settle_friction(m.parameters, m.x, triple(u.theta_m), m.anchors)
        inside = outputs_near(
            m.parameters, m.x, triple(u.theta_m), NO_MOTION, NO_MOTION, apex_frame(m.parameters), m.anchors, y
        )
        return 0 if inside else LEFT_WORKSPACE

    return start


@njit(cache=True)
def cross(a, b):
    """Return the vector product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def _share(w, a, b, c):
    """Return the coefficient of the triple `a` in `w`, a linear combination of `a`, `b`, `c` (Cramer's rule)."""
    n = cross(b, c)
    return (w[0] * n[0] + w[1] * n[1] + w[2] * n[2]) / (a[0] * n[0] + a[1] * n[1] + a[2] * n[2])


@step_function(PLANT_MEMORY, outputs=REST_OUTPUTS)
def rest(m, t, h, u, y):
    # `rest_state` without a LAPACK solver, which FMUs do not contain
    p = m.parameters
    px, py, pz = m.x[0], m.x[1], m.x[2]
    fx, fy, fz = contact_force(p, px, py, pz, 0.0, 0.0, 0.0, 0.0, 0.0)
    up, weight = upward(p), platform_weight(p)
    w = fx + weight * up[0], fy + weight * up[1], fz + weight * up[2]
    theta_1, theta_2, theta_3 = leg_angle(p, 0, px, py, pz), leg_angle(p, 1, px, py, pz), leg_angle(p, 2, px, py, pz)
    row_1 = jacobian_row(p, 0, theta_1, px, py, pz)
    row_2 = jacobian_row(p, 1, theta_2, px, py, pz)
    row_3 = jacobian_row(p, 2, theta_3, px, py, pz)
    tau = _share(w, row_1, row_2, row_3), _share(w, row_2, row_3, row_1), _share(w, row_3, row_1, row_2)
    theta = theta_1, theta_2, theta_3
    for leg in range(3):
        left = tau[leg] - arm_torque(p, up, leg, theta[leg]) - stop_torque(p, theta[leg])
        d = inverse_stop_deflection(p, left / joint_torque(p, leg, 1.0, 0.0) / series_share(p, leg))
        slack = p.backlash + p.backlash_added[leg]
        gap = 0.0 if d == 0.0 else math.copysign(slack, d)
        y.theta_m_rest[leg] = p.N * theta[leg] + d + gap + p.slip[leg]
    return 0
