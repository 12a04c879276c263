import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import ComponentStepper
from twin.robot.plant.encoder import Scale

# 0.005 kg on the display
RESOLUTION = 0.005 * 9.81
forces = st.floats(-20.0, 20.0)


@given(forces, forces, forces)
def test_reading_is_the_pressing_force_to_the_nearest_step(F_x, F_y, F_z):
    reading = ComponentStepper(Scale(RESOLUTION))(np.array([F_x, F_y, -F_z]))[0]
    steps = reading / RESOLUTION
    # rounding of up to 400 steps, and of forces of 20 N
    assert steps == pytest.approx(round(steps), abs=1e-12)
    assert abs(reading - F_z) <= RESOLUTION / 2.0 + 1e-12


def test_sideways_forces_do_not_weigh():
    assert ComponentStepper(Scale(RESOLUTION))(np.array([3.0, -4.0, 0.0]))[0] == 0.0
