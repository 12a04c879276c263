"""ideal_velocity.fmu against equations (1) and (2) of its README."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from .rig import Rig

speeds = st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=20)


@given(speeds=speeds, h=st.floats(1e-5, 0.1))
def test_speed_is_the_command_and_angle_its_integral(speeds: list[float], h: float) -> None:
    with Rig("ideal_velocity").start() as drive:
        angle = 0.0
        for omega_ref in speeds:
            drive["omega_ref"] = omega_ref
            drive.step(h)
            angle += omega_ref * h
            assert drive["omega_m"] == omega_ref
            assert drive["theta_m"] == angle  # the same two roundings in the same order


@pytest.mark.parametrize("tau_load", [-10.0, 0.1, 1e6])
def test_load_moves_nothing(tau_load: float) -> None:
    with Rig("ideal_velocity").start() as loaded, Rig("ideal_velocity").start() as free:
        loaded["tau_load"] = tau_load
        for drive in (loaded, free):
            drive["omega_ref"] = 0.3
            drive.run(1e-3, 50)
        assert loaded["omega_m"] == free["omega_m"]
        assert loaded["theta_m"] == free["theta_m"]
