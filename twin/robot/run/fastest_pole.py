"""Why a plant may have got out of hand: a pole that its integrator cannot follow."""

import numpy as np

from twin.kernel.errors import Unreachable
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import Equations, resting
from twin.robot.plant.dynamics import STATES, PlantParameters

STABLE = 2.7
"""|pole| times step up to which classical Runge-Kutta is stable: 2.78 on the real axis, 2.83 on the imaginary one."""
SMALL = np.array([1e-7] * 3 + [1e-5] * 3 + [1e-7] * 2)
"""Steps of the numerical derivatives: m, m/s, and m of the bristle."""
PRESSED = 1e-3
"""How deep (m) the platform is in the surface where the poles of contact are looked at."""


def too_fast(experiment: Experiment) -> str:
    """What to do about the plant's fastest pole, in a sentence; "" if the integrator follows it."""
    step = experiment.cosim.tick / experiment.plant.substeps
    pole = fastest_pole(experiment)
    if not pole * step > STABLE:
        return ""
    if pole == np.inf:
        return "The plant's poles are no numbers: look for a stiffness, mass or damping that is absurd."
    needed = int(np.ceil(pole * experiment.cosim.tick / STABLE))
    remedy = f"set [plant] substeps = {needed}, or " if needed <= 1000 else ""
    return (
        f"The plant's fastest pole is about {pole:.2g} 1/s, and steps of {1e6 * step:g} us ([cosim] tick_ms / [plant] "
        f"substeps) follow at most {STABLE / step:.2g} 1/s: {remedy}look for a stiffness or damping that is too large "
        "or a mass that is too small."
    )


def fastest_pole(experiment: Experiment) -> float:
    """|eigenvalue| (1/s) of the plant linearised at rest at its start, and pressed into the surface there; inf if what
    it is made of gives no numbers."""
    parameters = plant_parameters(experiment.plant, experiment.contact)
    start = np.array(experiment.start)
    x, theta_m = resting(parameters, start)
    poles = [_fastest(parameters, x, theta_m)]
    try:
        pressed = resting(parameters, [*start[:2], parameters.z_s - PRESSED])
        poles.append(_fastest(parameters, *pressed))
    except Unreachable:
        # what it cannot reach it has not touched
        pass
    return max(poles)


def _fastest(parameters: PlantParameters, x: np.ndarray, theta_m: np.ndarray) -> float:
    jacobian = np.empty((STATES, STATES))
    plant = Equations(parameters)
    # dry friction is stiffest while it holds
    plant.hold(x, theta_m)
    for i, small in enumerate(SMALL):
        step = small * np.eye(STATES)[i]
        jacobian[:, i] = (plant.derivative(x + step, theta_m) - plant.derivative(x - step, theta_m)) / (2.0 * small)
    if not np.isfinite(jacobian).all():
        return np.inf
    return float(np.abs(np.linalg.eigvals(jacobian)).max())
