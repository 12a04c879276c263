"""Energy of the robot in a run, from what is recorded of it."""

import numpy as np
from numpy.typing import NDArray

from tests.robot.plant.kinetic import kinetic_energy
from tests.robot.plant.test_energy import stored
from twin.robot.mechanism.statics import G_ACCELERATION, platform_weight
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.trace import Trace

Numbers = NDArray[np.float64]


def deflection(parameters: PlantParameters, theta_m: Numbers, theta_l: Numbers) -> Numbers:
    """Deflection of the springs beyond their backlash (n, 3), rad."""
    d = theta_m - parameters.N * theta_l
    return np.sign(d) * np.maximum(np.abs(d) - parameters.backlash, 0.0)


def gained_with_motors_held(parameters: PlantParameters, rows: Trace, scheme: str) -> Numbers:
    """What the robot's energy (J) grows by within each tick (n - 1,), on a plane that does not move.

    The plant sees the motors' angles of a tick's end, in Jacobi's scheme of its start, all through the tick. Energy is
    kinetic, of weight, springs, surface and bristle.
    """
    theta_m = rows.of_drives("theta_m")
    held = theta_m[:-1] if scheme == "jacobi" else theta_m[1:]
    p_B, v_B, theta_l, omega_l = (rows[f"plant.{name}"] for name in ("p_B", "v_B", "theta_l", "omega_l"))
    n = np.array([np.sin(parameters.tilt), 0.0, np.cos(parameters.tilt)])
    depth = np.maximum((np.array([0.0, 0.0, parameters.z_s]) - p_B) @ n, 0.0)
    moment = (parameters.m_a + parameters.m_b) / 2.0 * parameters.l_a
    without_springs = (
        kinetic_energy(parameters, theta_l, omega_l, v_B)
        + platform_weight(parameters) * p_B[:, 2]
        - moment * G_ACCELERATION * np.sin(theta_l).sum(axis=1)
        + stored(parameters, depth)
        + parameters.sigma_0 * np.sum(rows["plant.z_b"] ** 2, axis=1) / 2.0
    )
    before, after = (deflection(parameters, held, theta_l[part]) for part in (slice(-1), slice(1, None)))
    return np.diff(without_springs) + parameters.k_s * np.sum(after**2 - before**2, axis=1) / 2.0
