"""The plant as a python-control system: the right-hand side and outputs that the co-simulation component steps.

One dynamics, two users: nothing of the physics is written here.
"""

from typing import Any

import control
import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import Port
from twin.robot.plant.component import INPUTS, OUTPUTS, Equations
from twin.robot.plant.dynamics import PlantParameters

STATE_LABELS = ["p_B_x", "p_B_y", "p_B_z", "v_B_x", "v_B_y", "v_B_z", "z_b_1", "z_b_2"]


def signal_labels(ports: tuple[Port, ...]) -> list[str]:
    """One label per value of `ports`: `p_B_x` for a vector in frame B, `theta_l_1` for a leg, `F_n` for a scalar."""
    labels = []
    for port in ports:
        parts = "xyz" if port.name.endswith("_B") else [str(i + 1) for i in range(port.size)]
        labels += [port.name] if port.size == 1 else [f"{port.name}_{part}" for part in parts]
    return labels


def plant_system(parameters: PlantParameters) -> control.NonlinearIOSystem:
    """Springs, mechanism and contact as a continuous-time `control.NonlinearIOSystem`, SI. The surface stays at rest.

    The equations are those of `twin/robot/plant/dynamics.py` and `twin/robot/plant/contact.py`. Between the component and this
    system there is one difference: the component scales its bristle back onto the friction cone after each step
    (`twin.robot.plant.component.settle`), a jump that a differential equation cannot make. While the robot slides the state
    z_b may therefore be longer here; the friction force is inside the cone in both.

    Args:
        parameters: what is true. They become the system's `params`, a dictionary of the same names, so that one value
            can be replaced for one call: `control.linearize(system, x, u, params={"k_s": 2.0})`.

    Returns:
        A system with inputs theta_m_1 .. theta_m_3 (rad), the 8 states of `twin/robot/plant/dynamics.py` (`STATE_LABELS`)
        and the 24 values of the component's output ports, labelled as in `signal_labels`. Outside the workspace its
        derivative is NaN.
    """
    return control.nlsys(
        _derivative,
        _outputs,
        params=parameters._asdict(),
        inputs=signal_labels(INPUTS),
        outputs=signal_labels(OUTPUTS),
        states=STATE_LABELS,
        name="plant",
    )


def linear_plant(parameters: PlantParameters, x: NDArray, theta_m: NDArray) -> control.StateSpace:
    """`plant_system` for small deviations from rest at `x` (8,), `theta_m` (3,): inputs and outputs of the same names.

    Its 6 states are p_B and v_B. The bristle is none of its own: while friction sticks, dz_b/dt = E v_B, so z_b is
    E p_B but for where it was straight, which nothing changes; as a state that constant would be a pole at 0.
    """
    linear = control.linearize(plant_system(parameters), x, theta_m)
    bristle = np.vstack([np.eye(6), np.hstack([linear.A[6:, 3:6], np.zeros((2, 3))])])
    return control.ss(
        linear.A[:6] @ bristle,
        linear.B[:6],
        linear.C @ bristle,
        linear.D,
        inputs=signal_labels(INPUTS),
        outputs=signal_labels(OUTPUTS),
        states=STATE_LABELS[:6],
        name="plant",
    )


def _derivative(t: float, x: NDArray, u: NDArray, params: dict[str, Any]) -> NDArray[np.float64]:
    return Equations(PlantParameters(**params)).derivative(x, u)


def _outputs(t: float, x: NDArray, u: NDArray, params: dict[str, Any]) -> NDArray[np.float64]:
    y: NDArray[np.float64] = Equations(PlantParameters(**params)).outputs(x, u).view(np.float64)
    return y
