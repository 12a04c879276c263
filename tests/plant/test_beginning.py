"""A plant that is taken elsewhere begins as the plant here does."""

import ctypes

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.conftest import examples
from tests.laws.runs import PARAMETERS
from tests.plant.states import moving, positions
from twin.compiled.native import Native
from twin.cosim.port import width
from twin.cosim.record import memory_of
from twin.plant.beginning import REST_OUTPUTS, outputs_at_start, rest
from twin.plant.component import MEMORY, OUTPUTS, Plant
from twin.plant.equilibrium import resting
from twin.plant.friction import ANCHORS
from twin.plant.parameters import PlantParameters

STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
TILTED = PARAMETERS._replace(mounting_tilt=0.3, mounting_tilt_x=-0.2)
STICKING = TILTED._replace(joint_friction=0.2, spring_hysteresis=0.1)


def begun(native: Native, size: int, parameters: PlantParameters, x, theta_m) -> NDArray[np.float64]:
    """What a beginning makes of a plant that was moved away from where it had stuck."""
    memory = memory_of(MEMORY, parameters=tuple(parameters), x=x, anchors=np.full((3, ANCHORS), 0.1))
    y = np.empty(size)
    STEP(native.address)(memory.ctypes.data, 0.0, 1e-3, np.array(theta_m).ctypes.data, y.ctypes.data)
    return y


@given(positions(), st.sampled_from([PARAMETERS, TILTED]))
def test_it_rests_where_the_plant_here_rests(p_B, parameters):
    x, theta_m = resting(parameters, p_B)
    found = begun(rest, width(REST_OUTPUTS), parameters, x, theta_m)
    # rounding of angles near 40 rad
    np.testing.assert_allclose(found, theta_m, rtol=1e-12, atol=0)


@examples(20)
@given(moving(STICKING))
def test_its_first_outputs_are_those_of_a_new_plant(state):
    found = begun(outputs_at_start(False, False), width(OUTPUTS), STICKING, *state)
    np.testing.assert_array_equal(found, Plant(STICKING, *state).initial_outputs)
