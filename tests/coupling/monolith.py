"""The coupled robot as one differential equation: the reference that a co-simulation is an approximation of.

Plant and drives exchange theta_m and tau_load at every instant. scipy integrates them from controller tick to
controller tick; at a tick the same compiled encoder, estimator and controller run as in the co-simulation. What is left
to differ is the coupling alone.

`coupled_system` says what is integrated, in terms of python-control; `coupled_derivative` is the same compiled, which
makes 20 s of it affordable, and `test_monolith.py` holds the two together.
"""

import control
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.laws.runs import Sampled
from twin.analysis.plant_system import plant_system, signal_labels
from twin.assembly import belief, controller
from twin.controller.estimator import Estimator
from twin.cosim.component import width
from twin.experiment.experiment import Experiment
from twin.experiment.true_parameters import plant_parameters
from twin.plant.component import OUTPUTS, STILL, outputs, settle
from twin.plant.dynamics import derivative
from twin.plant.encoder import Encoder
from twin.plant.equilibrium import resting

LEGS = (1, 2, 3)
OUTPUT_VALUES = width(OUTPUTS)
THETA_L, TAU_LOAD = slice(6, 9), 15
ESTIMATES_USED = [*range(6, 18), *range(21, 24)]
"""Of the estimator's outputs p_B, J and F_ee_B go to the controller."""

T_M = 0.020
"""Default of velocity_servo.fmu (s)."""

# 1e-10 m, m/s and rad are 1e-6 N; the bristle's rate jumps whenever friction sticks or slips, and 1e-8 m of it are
# 4e-5 N
RTOL, ATOL = 1e-9, np.array([1e-10] * 12 + [1e-8] * 2)


def drive_droop(experiment: Experiment) -> NDArray[np.float64]:
    """The three drives' droop (3,), rad/s per N m: the only parameter that the experiments set."""
    return np.array([drive.parameters["droop"] for drive in experiment.drives])


def velocity_servos(T_m: float, droop: NDArray[np.float64]) -> control.StateSpace:
    """T_m d omega_m/dt = omega_ref - droop tau_load - omega_m per leg: velocity_servo.fmu with its limits out of reach.

    States theta_m_1 .. 3, omega_m_1 .. 3. One system of three, because `control.interconnect` pays per system.
    """
    O, I = np.zeros((3, 3)), np.eye(3)
    return control.ss(
        np.block([[O, I], [O, -I / T_m]]),
        np.block([[O, O], [I / T_m, -np.diag(droop) / T_m]]),
        np.block([I, O]),
        np.zeros((3, 6)),
        inputs=[f"{signal}_{leg}" for signal in ("omega_ref", "tau_load") for leg in LEGS],
        outputs=[f"theta_m_{leg}" for leg in LEGS],
        name="drives",
    )


def coupled_system(experiment: Experiment) -> control.InterconnectedSystem:
    """Three drives and the plant, inputs omega_ref_1 .. 3, outputs those of the plant and theta_m_1 .. 3."""
    drives = velocity_servos(T_M, drive_droop(experiment))
    plant = plant_system(plant_parameters(experiment.plant, experiment.contact))
    return control.interconnect(
        [drives, plant],
        inputs=[f"omega_ref_{leg}" for leg in LEGS],
        outputs=[*plant.output_labels, *drives.output_labels],
    )


@njit(cache=True)
def coupled_derivative(parameters, T_m, droop, omega_ref, x):
    """What `coupled_system` evaluates, compiled: dx/dt (14,) at x = (theta_m, omega_m, plant's state)."""
    dx = np.empty_like(x)
    dx[:3] = x[3:6]
    y = np.empty(OUTPUT_VALUES)
    outputs(parameters, x[6:], x[:3], STILL, STILL, y)
    for leg in range(3):
        dx[3 + leg] = (omega_ref[leg] - droop[leg] * y[TAU_LOAD + leg] - x[3 + leg]) / T_m
    derivative(parameters, x[6:], x[:3], STILL, STILL, dx[6:])
    return dx


def monolithic_run(experiment: Experiment, duration: float) -> dict[str, NDArray[np.float64]]:
    """Run `experiment` without co-simulating it.

    Returns:
        By label, one value per controller tick from 0 to `duration` (s): the outputs of the plant.
    """
    parameters, p = plant_parameters(experiment.plant, experiment.contact), experiment.plant
    x_plant, theta_m = resting(parameters, experiment.start)
    x = np.concatenate([theta_m, np.zeros(3), x_plant])
    encoder = Sampled(Encoder(p.motor_counts_per_turn, p.joint_counts_per_turn, p.motor_zero, p.joint_zero))
    estimator = Sampled(Estimator(belief(experiment), experiment.controller.gravity_compensation))
    law = Sampled(controller(experiment))
    T_s, droop = experiment.controller.period, drive_droop(experiment)
    rows = np.empty((round(duration / T_s) + 1, OUTPUT_VALUES))
    for k, y in enumerate(rows):
        outputs(parameters, x[6:], x[:3], STILL, STILL, y)
        counts = encoder(np.concatenate([x[:3], y[THETA_L]]))
        estimate = estimator(counts[:6])
        omega_ref = law(estimate[ESTIMATES_USED], k * T_s, T_s)[:3]

        def rate(_t, x, omega_ref=omega_ref):
            return coupled_derivative(parameters, T_M, droop, omega_ref, x)

        solution = solve_ivp(rate, (0.0, T_s), x, method="DOP853", first_step=T_s, rtol=RTOL, atol=ATOL)
        x = solution.y[:, -1]
        settle(parameters, x[6:], STILL, STILL)
    return dict(zip(signal_labels(OUTPUTS), rows.T, strict=True))
