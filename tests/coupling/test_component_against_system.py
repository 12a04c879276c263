"""The co-simulation component alone follows the differential equation that python-control sees."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.laws.runs import PARAMETERS, Sampled
from twin.analysis.plant_system import plant_system
from twin.plant.component import Plant, settle
from twin.plant.equilibrium import resting

TICK = 1e-3
SYSTEM = plant_system(PARAMETERS)


def held_motor_angles(theta_m, ticks):
    """Motor angles held over each tick that press, sweep sideways and turn back, shape (ticks, 3)."""
    t = np.arange(ticks) * TICK
    press = 0.15 * (1.0 - np.cos(2.0 * np.pi * 2.0 * t))
    sweep = 0.10 * np.sin(2.0 * np.pi * 4.0 * t)
    return theta_m + np.stack([press + sweep, press, press - sweep], axis=-1)


def component_states(start, inputs, substeps):
    plant = Plant(PARAMETERS, *start, substeps=substeps)
    stepped = Sampled(plant)
    y = np.array([stepped(u, 0.0, TICK) for u in inputs])
    return np.concatenate([y[:, :6], y[:, 22:24]], axis=1), y[:, 18:21]


def integrated_states(start, inputs):
    """The same with scipy; friction settles after each tick as the component's does after each of its steps."""
    x, _ = start
    states, forces = [], []
    for u in inputs:
        x = solve_ivp(
            lambda _, x: SYSTEM.dynamics(0.0, x, u),  # noqa: B023
            (0.0, TICK), x, method="DOP853", first_step=TICK, rtol=1e-10, atol=1e-12,
        ).y[:, -1]  # fmt: skip
        settle(PARAMETERS, x[6:] if False else x)
        states.append(x)
        forces.append(SYSTEM.output(0.0, x, u)[18:21])
    return np.array(states), np.array(forces)
