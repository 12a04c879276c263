"""The reference is what it claims to be."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.coupling.monolith import T_M, coupled_system, drive_droop
from tests.laws.runs import PARAMETERS, shipped
from twin.robot.plant.component import rest_state
from twin.studies.converge.monolith import CoupledEquations

EXPERIMENT = shipped()
SYSTEM = coupled_system(EXPERIMENT)

share = st.floats(-1.0, 1.0)


@st.composite
def coupled_states(draw: st.DrawFn) -> NDArray[np.float64]:
    """Near an equilibrium of the task, in air or in contact, moving; shape (14,)."""
    p_B = [0.02 * draw(share), 0.02 * draw(share), draw(st.floats(-0.110, -0.085))]
    x, theta_m = rest_state(PARAMETERS, p_B)
    x[3:6] = [0.1 * draw(share) for _ in range(3)]
    x[6:] = [2e-4 * draw(share) for _ in range(2)]
    theta_m += [0.05 * draw(share) for _ in range(3)]
    return np.concatenate([theta_m, [draw(share) for _ in range(3)], x])


@given(coupled_states(), st.tuples(share, share, share).map(np.array))
def test_what_scipy_integrates_is_what_python_control_interconnects(x, omega_ref):
    compiled = CoupledEquations(PARAMETERS, np.full(3, T_M), drive_droop(EXPERIMENT)).derivative(omega_ref, x)
    # rounding: the two add up the droop in another order; speeds change by up to 1e2 rad/s2
    np.testing.assert_allclose(compiled, SYSTEM.dynamics(0.0, x, omega_ref), rtol=1e-12, atol=1e-12)
