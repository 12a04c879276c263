import math

import numpy as np
import pytest

from tests.robot.mechanism.poses import GEOMETRY, HOME, MASSES
from twin.robot.mechanism.geometry import leg_motion, leg_vectors
from twin.robot.mechanism.kinematics import circumcentre, jacobian_row, leg_angle, leg_angle_inward, platform_position
from twin.robot.mechanism.statics import (
    arm_gravity_torque,
    dead_zone,
    directed_load_torque,
    environment_force,
    leg_force,
    leg_inertia,
    load_torque,
    platform_weight,
    resultant_force,
)

P_B = (0.012, -0.017, -0.104)
THETA_L = tuple(leg_angle(GEOMETRY, leg, *P_B) for leg in range(3))

CALLS = [
    (leg_angle, (GEOMETRY, 2, *P_B)),
    (leg_angle, (GEOMETRY, 2, 0.0, 0.0, -0.5)),
    (leg_angle_inward, (GEOMETRY, 2, *P_B)),
    (circumcentre, (GEOMETRY, *THETA_L)),
    (platform_position, (GEOMETRY, *THETA_L)),
    (platform_position, (GEOMETRY._replace(l_b=0.07), 0.0, 0.0, 0.0)),
    (jacobian_row, (GEOMETRY, 1, THETA_L[1], *P_B)),
    (leg_vectors, (GEOMETRY, 1, *P_B)),
    (leg_motion, (GEOMETRY, *leg_vectors(GEOMETRY, 1, *P_B), 0.1, -0.2, 0.3)),
    (leg_force, (GEOMETRY, 1, THETA_L[1], *P_B, 0.2)),
    (resultant_force, (GEOMETRY, THETA_L, P_B, (0.1, 0.2, -0.3))),
    (environment_force, (GEOMETRY, MASSES, THETA_L, P_B, (0.1, 0.2, -0.3))),
    (arm_gravity_torque, (GEOMETRY, MASSES, 0.3)),
    (platform_weight, (MASSES,)),
    (leg_inertia, (GEOMETRY, MASSES)),
    (dead_zone, (0.3, 0.1)),
    (load_torque, (1.0, 2.0, 0.9, 0.3)),
    (directed_load_torque, (1.0, 2.0, 0.9, 0.3, 0.004, 0.01)),
]


@pytest.mark.parametrize(("core", "arguments"), CALLS, ids=lambda value: getattr(value, "__name__", ""))
def test_compiled_and_interpreted_agree_to_rounding(core, arguments):
    # one unit in the last place per library function: compilers may link another libm
    np.testing.assert_allclose(core(*arguments), core.__wrapped__(*arguments), rtol=1e-14, atol=1e-17)


def as_record(values):
    dtype = np.dtype([(name, np.float64) for name in values._fields])
    return np.array([tuple(values)], dtype=dtype).view(np.recarray)[0]


def test_any_record_with_the_right_attributes_serves_as_geometry_and_masses():
    geometry, masses = as_record(GEOMETRY), as_record(MASSES)
    assert leg_angle(geometry, 0, *HOME) == leg_angle(GEOMETRY, 0, *HOME)
    assert platform_position(geometry, *THETA_L) == platform_position(GEOMETRY, *THETA_L)
    assert jacobian_row(geometry, 0, THETA_L[0], *P_B) == jacobian_row(GEOMETRY, 0, THETA_L[0], *P_B)
    arguments = THETA_L, P_B, (0.1, 0.2, 0.3)
    assert environment_force(geometry, masses, *arguments) == environment_force(GEOMETRY, MASSES, *arguments)


def test_a_vanishing_denominator_gives_no_exception_inside_compiled_code():
    # horizontal arm with its distal link horizontal too: s . d = 0 exactly
    flat = GEOMETRY._replace(l_b=0.020)
    row = jacobian_row(flat, 0, 0.0, 0.0, -0.040 - 0.020, 0.0)
    assert not any(math.isfinite(value) and value != 0.0 for value in row)
