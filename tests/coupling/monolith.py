"""The coupled robot as one differential equation: the reference that a co-simulation is an approximation of.

Plant and drives are joined by `control.interconnect`, so they exchange theta_m and tau_load at every instant. scipy
integrates them from controller tick to controller tick; at a tick the same compiled encoder, estimator and controller
run as in the co-simulation. What is left to differ is the coupling alone.
"""

import ctypes
import warnings
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from twin.analysis.plant_system import plant_system
from twin.assembly import belief, controller, plant_parameters
from twin.controller.estimator import Estimator
from twin.cosim.component import Component, width
from twin.experiment.experiment import Experiment
from twin.plant.component import settle
from twin.plant.encoder import Encoder
from twin.plant.equilibrium import resting

_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)

# relative 1e-9 of states near 0.1 m and 1 rad; absolute the same in m, m/s and rad: below 1e-5 N of force
RTOL, ATOL = 1e-9, 1e-10


@dataclass
class Sampled:
    """A sampled component, evaluated by hand."""

    component: Component

    def __post_init__(self) -> None:
        self._step = _STEP(self.component.step_address)
        self._y = np.zeros(width(self.component.outputs))

    def outputs(self, t: float, h: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """All output values for all input values `u` at time `t` (s), a view that the next call overwrites."""
        u = np.ascontiguousarray(u, dtype=float)
        assert self._step(self.component.self_address, t, h, u.ctypes.data, self._y.ctypes.data) == 0
        return self._y


def velocity_servo(leg: int, T_m: float, droop: float) -> control.StateSpace:
    """T_m d omega_m/dt = omega_ref - droop tau_load - omega_m: velocity_servo.fmu with its limits out of reach."""
    return control.ss(
        [[0.0, 1.0], [0.0, -1.0 / T_m]],
        [[0.0, 0.0], [1.0 / T_m, -droop / T_m]],
        np.eye(2),
        np.zeros((2, 2)),
        inputs=[f"omega_ref_{leg}", f"tau_load_{leg}"],
        outputs=[f"theta_m_{leg}", f"omega_m_{leg}"],
        states=[f"theta_m_{leg}", f"omega_m_{leg}"],
        name=f"drive_{leg}",
    )


def coupled_system(experiment: Experiment) -> control.InterconnectedSystem:
    """Three drives and the plant, inputs omega_ref_1 .. 3, outputs those of the plant and theta_m_1 .. 3.

    T_m is the FMU's default, the experiment sets droop only.
    """
    plant = plant_system(plant_parameters(experiment))
    drives = [velocity_servo(i + 1, 0.020, d.parameters["droop"]) for i, d in enumerate(experiment.drives)]
    with warnings.catch_warnings():
        # omega_m is of no interest
        warnings.filterwarnings("ignore", "Unused output")
        return control.interconnect(
            [*drives, plant],
            inputs=[f"omega_ref_{leg}" for leg in (1, 2, 3)],
            outputs=[*plant.output_labels, *(f"theta_m_{leg}" for leg in (1, 2, 3))],
        )


def monolithic_run(experiment: Experiment, duration: float) -> dict[str, NDArray[np.float64]]:
    """Run `experiment` without co-simulating it.

    Returns:
        By label, one value per controller tick from 0 to `duration` (s): the outputs of `coupled_system`.
    """
    system = coupled_system(experiment)
    parameters, p = plant_parameters(experiment), experiment.plant
    x_plant, theta_m = resting(parameters, experiment.reference.p[0])
    x = np.concatenate([np.stack([theta_m, np.zeros(3)], axis=-1).ravel(), x_plant])
    encoder = Sampled(Encoder(p.motor_counts_per_turn, p.joint_counts_per_turn, p.motor_zero, p.joint_zero))
    estimator = Sampled(Estimator(belief(experiment), experiment.controller.gravity_compensation))
    law = Sampled(controller(experiment))
    T_s = experiment.controller.period
    theta_l = [system.output_labels.index(f"theta_l_{leg}") for leg in (1, 2, 3)]
    omega_ref = np.zeros(3)
    rows = []
    for k in range(round(duration / T_s) + 1):
        t = k * T_s
        y = system.output(t, x, omega_ref)
        rows.append(y)
        counts = encoder.outputs(t, T_s, np.concatenate([y[-3:], y[theta_l]]))
        estimate = estimator.outputs(t, T_s, counts)
        omega_ref = law.outputs(t, T_s, estimate[[*range(6, 18), 21, 22, 23]])[:3].copy()
        x = solve_ivp(
            lambda t, x: system.dynamics(t, x, omega_ref),
            (t, t + T_s), x, method="DOP853", first_step=T_s, rtol=RTOL, atol=ATOL,
        ).y[:, -1]  # fmt: skip
        settle(parameters, x[6:])
    return dict(zip(system.output_labels, np.array(rows).T, strict=True))
