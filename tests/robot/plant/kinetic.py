"""Kinetic energy of the robot as (P2) of docs/physics.md has it, from speeds that are known."""

import numpy as np
from numpy.typing import NDArray

from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN
from twin.robot.mechanism.statics import leg_inertia, moving_mass
from twin.robot.plant.dynamics import PlantParameters

Numbers = NDArray[np.float64]


def kinetic_energy(parameters: PlantParameters, theta_l: Numbers, omega_l: Numbers, v_B: Numbers) -> Numbers:
    """In J, shape (...); angles, speeds and velocities (..., 3)."""
    outward = v_B[..., :1] * LEG_COS + v_B[..., 1:2] * LEG_SIN
    # velocity of each knee times v_B: what couples the two ends of a uniform rod
    knees = -parameters.l_a * (outward * np.sin(theta_l) + v_B[..., 2:] * np.cos(theta_l)) * omega_l
    return (
        moving_mass(parameters) * np.sum(v_B**2, axis=-1) / 2.0
        + leg_inertia(parameters, parameters) * np.sum(omega_l**2, axis=-1) / 2.0
        + parameters.m_b / 6.0 * np.sum(knees, axis=-1)
    )


def mass_matrix(parameters: PlantParameters, theta_l: Numbers, J: Numbers) -> Numbers:
    """M (3, 3) in kg, of which v M v / 2 is the kinetic energy."""

    def energy(v: Numbers) -> Numbers:
        return kinetic_energy(parameters, theta_l, J @ v, v)

    e = np.eye(3)
    return np.array([[energy(a + b) - energy(a) - energy(b) for b in e] for a in e])
