"""States of the plant that hypothesis draws: the working range of the paper's task and a little around it."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.laws.runs import PARAMETERS
from twin.robot.plant.component import rest_state
from twin.robot.plant.contact_law import ContactLaw
from twin.robot.plant.dynamics import PlantParameters

# in steps of 1e-3: numbers near the smallest float would only test underflow
SURFACES = {
    "Hunt-Crossley": PARAMETERS,
    "Hunt-Crossley, exponent 1.5": PARAMETERS._replace(K=800.0, exponent=1.5, reference_depth=0.005, damping=1.0),
    "Kelvin-Voigt": PARAMETERS._replace(law=int(ContactLaw.KELVIN_VOIGT), K=500.0, damper=15.0, touch_depth=0.002),
    "exponential": PARAMETERS._replace(law=int(ContactLaw.EXPONENTIAL), K=600.0, stiffening=150.0, damping=1.5),
}
"""A plant for every law of contact, as stiff as people are."""

share = st.integers(-1000, 1000).map(lambda whole: whole / 1000.0)


@st.composite
def positions(draw: st.DrawFn, lowest: float = -0.115, highest: float = -0.085) -> NDArray[np.float64]:
    return np.array([0.025 * draw(share), 0.025 * draw(share), draw(st.floats(lowest, highest))])


@st.composite
def moving(
    draw: st.DrawFn, parameters: PlantParameters = PARAMETERS, lowest: float = -0.115, highest: float = -0.085
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State x (8,) and motor angles theta_m (3,): off balance by up to 0.1 rad per motor, moving at up to 0.3 m/s."""
    x, theta_m = rest_state(parameters, draw(positions(lowest, highest)))
    x[3:6] = [0.3 * draw(share) for _ in range(3)]
    x[6:8] = [3e-4 * draw(share) for _ in range(2)]
    return x, theta_m + np.array([0.1 * draw(share) for _ in range(3)])
