"""Driving-point impedance felt by a hand at the platform: drives, springs and sampled loops.

The body is removed; in its place a force F acts on the platform, held from one call of the controller to the next.
During this time the platform moves by p(k+1) - p(k), so the hand's work is exactly F(k).(p(k+1) - p(k)). The admittance
from F to the mean velocity of a period,

    Y(z) = (z - 1)/T C_p (z 1 - A)^-1 B_F,

is therefore passive, i.e. returns at most the work done on it, if and only if the robot by itself is stable and the
Hermitian part of Y is positive semidefinite at all frequencies up to half the controller's rate (discrete-time positive
real: Hitz and Anderson 1969). So is Z = Y^-1; sampling, holding and delay are all included (Colgate and Schenkel 1997).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import Port
from twin.robot.plant.component import PLANT_INPUTS, PLANT_OUTPUTS
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.plant.equations import PlantEquations
from twin.studies.analyse.linear import loops

STATE_LABELS = ["p_B_x", "p_B_y", "p_B_z", "v_B_x", "v_B_y", "v_B_z", "z_b_1", "z_b_2"]
AXES = ("x", "y", "z")
ROUNDING_TOLERANCE = 1e-9
"""Tolerance for rounding in the magnitude of a pole and in a share of power."""
MIN_FREQUENCY = 0.02
"""Minimum evaluated frequency (Hz), below which a robot drifts rather than responds."""
DRIFT_RATE = 0.01
"""Maximum growth rate (1/s) of a drift, not a swing: a force loop that lost its surface, whose geometry changes."""
Complex = NDArray[np.complex128]


def signal_labels(ports: tuple[Port, ...]) -> list[str]:
    """Return a label per port value: `p_B_x` for a vector in frame B, `theta_l_1` for a leg, `F_n` for a scalar."""
    labels = []
    for port in ports:
        parts = "xyz" if port.name.endswith("_B") else [str(i + 1) for i in range(port.size)]
        labels += [port.name] if port.size == 1 else [f"{port.name}_{part}" for part in parts]
    return labels


def plant_system(parameters: PlantParameters) -> control.NonlinearIOSystem:
    """Build springs, mechanism and contact on a resting surface as a `control.NonlinearIOSystem`, SI, continuous time.

    The equations are those in `twin/robot/plant/dynamics.py` and `twin/robot/plant/contact.py`. The component differs
    from this system in one point: it scales its bristle back onto the friction cone after each step
    (`twin.robot.plant.component.settle`), a jump that a differential equation cannot make. While the robot slides the
    state z_b may therefore be longer here; the friction force is inside the cone in both.

    Args:
        parameters: true parameters. They become the system's `params`, a dictionary of the same names, so that one
            value can be replaced for one call: `control.linearize(system, x, u, params={"k_s": 2.0})`.

    Returns:
        A system with inputs theta_m_1 .. theta_m_3 (rad), the 8 states of `twin/robot/plant/dynamics.py`
            (`STATE_LABELS`) and the 24 values of the component's output ports, labelled as in `signal_labels`. Outside
            the workspace its derivative is NaN.
    """
    params = parameters._asdict()
    return control.nlsys(_derivative, _outputs, params=params, states=STATE_LABELS, **_plant_labels())


def linear_plant(parameters: PlantParameters, x: NDArray, theta_m: NDArray) -> control.StateSpace:
    """Linearise the plant about rest at a state (8,) and motor angles (3,), as a `control.StateSpace`.

    Its 6 states are p_B and v_B. The bristle is not a state: while friction sticks, dz_b/dt = E v_B, so z_b is E p_B
    plus a constant (the position where it was straight), which as a state would be a pole at 0.
    """
    linear = control.linearize(plant_system(parameters), x, theta_m)
    bristle = np.vstack([np.eye(6), np.hstack([linear.A[6:, 3:6], np.zeros((2, 3))])])
    A, C = linear.A[:6] @ bristle, linear.C @ bristle
    return control.ss(A, linear.B[:6], C, linear.D, states=STATE_LABELS[:6], **_plant_labels())


def _plant_labels() -> dict[str, Any]:
    return {"inputs": signal_labels(PLANT_INPUTS), "outputs": signal_labels(PLANT_OUTPUTS), "name": "plant"}


def _derivative(t: float, x: NDArray, u: NDArray, params: dict[str, Any]) -> NDArray[np.float64]:
    return PlantEquations(PlantParameters(**params)).derivative(x, u)


def _outputs(t: float, x: NDArray, u: NDArray, params: dict[str, Any]) -> NDArray[np.float64]:
    y: NDArray[np.float64] = PlantEquations(PlantParameters(**params)).outputs(x, u).view(np.float64)
    return y


class HandLoad(NamedTuple):
    """A passive load in the hand, on the platform: symmetric (3, 3), kg, N/m to the ground, and N s/m."""

    mass: loops.Matrix
    stiffness: loops.Matrix
    damping: loops.Matrix


EMPTY_HAND = HandLoad(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


def load_along(direction: loops.Matrix, mass: float, stiffness: float) -> HandLoad:
    """Return a mass (kg) and a spring (N/m) in the hand that act only along `direction` (3,)."""
    n = np.outer(direction, direction) / float(np.dot(direction, direction))
    return HandLoad(mass * n, stiffness * n, np.zeros((3, 3)))


@dataclass(frozen=True)
class FreePlant:
    """Linear model of springs and mechanism around an operating point, without the body, which `linear` includes."""

    linear: control.StateSpace

    @cached_property
    def mass(self) -> loops.Matrix:
        """Mass matrix (3, 3) that the springs' torques accelerate (kg)."""
        rows = self._rows
        jacobian, spring_torque = self.linear.C[rows["theta_l_1"] :][:3, :3], self.linear.D[rows["tau_l_1"] :][:3]
        return np.linalg.solve(self.linear.B[3:6].T, (jacobian.T @ spring_torque).T).T

    @cached_property
    def force(self) -> loops.Matrix:
        """Force on the platform by springs and mechanism per displacement and velocity (3, 6), N per m and m/s."""
        body = self.linear.C[self._rows["F_ee_B_x"] :][:3]
        return self.mass @ self.linear.A[3:6] + body

    @property
    def stiffness(self) -> loops.Matrix:
        """Stiffness (3, 3) of the springs in the hand with the motors held (N/m)."""
        return -self.force[:, :3]

    def with_load(self, held: HandLoad) -> control.StateSpace:
        """Return the linear plant with a load in the hand, and with a constant force as three further states."""
        A, B = np.zeros((9, 9)), np.zeros((9, 3))
        inertia = np.linalg.inv(self.mass + held.mass)
        A[:3, 3:6] = np.eye(3)
        A[3:6, :6] = inertia @ (self.force - np.hstack([held.stiffness, held.damping]))
        A[3:6, 6:] = inertia
        B[3:6] = inertia @ self.mass @ self.linear.B[3:6]
        C = np.hstack([self.linear.C, np.zeros((len(self.linear.C), 3))])
        return control.ss(A, B, C, self.linear.D, inputs=self.linear.input_labels, outputs=self.linear.output_labels)

    @property
    def _rows(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.linear.output_labels)}


@dataclass(frozen=True)
class Hand:
    """The closed loops as felt by a hand at the platform: x(k+1) = A x + B F, p = C x, at the period (s)."""

    A: loops.Matrix
    B: loops.Matrix
    C: loops.Matrix
    period: float

    def admittance(self, omega: loops.Matrix) -> Complex:
        """Return the admittance Y (n, 3, 3) that the hand feels, m/s per N, at the frequencies `omega` (rad/s)."""
        z = np.exp(1j * omega * self.period)[:, None, None]
        states = np.linalg.solve(z * np.eye(len(self.A)) - self.A, np.broadcast_to(self.B, (len(omega), *self.B.shape)))
        return (z - 1.0) / self.period * (self.C @ states)

    @property
    def stiffness(self) -> loops.Matrix:
        """Steady stiffness (3,) that the hand feels along each axis, with the other axes free (N/m)."""
        compliance = self.C @ np.linalg.solve(np.eye(len(self.A)) - self.A, self.B)
        return 1.0 / np.diagonal(compliance)

    @property
    def poles(self) -> Complex:
        """Poles of the closed loops in z, with the robot in the hand."""
        return np.linalg.eigvals(self.A).astype(complex)

    @property
    def growth(self) -> float:
        """Growth rate of the fastest growing or slowest decaying pole (1/s); 0 for a platform that stays anywhere."""
        return float(np.log(np.abs(self.poles).max()) / self.period)

    @property
    def stable(self) -> bool:
        """Whether the robot in the hand is stable: every pole grows no faster than a drift."""
        return self.growth < DRIFT_RATE


def robot_with(
    free: FreePlant, held: HandLoad, drives: tuple[loops.DriveModel, ...], stepping: loops.LoopStepping
) -> control.StateSpace:
    return loops.period_map(loops.tick_map(free.with_load(held), drives, stepping), stepping)


def hand_of(robot: control.StateSpace, law: loops.LinearLaw, gains: dict[str, float]) -> Hand:
    closed = loops.closed_loops(loops.open_loops(robot, law, whole=True), gains)
    force = np.arange(6, 9)
    rest = np.setdiff1d(np.arange(closed.nstates), force)
    A, B = closed.A[np.ix_(rest, rest)], closed.A[np.ix_(rest, force)]
    C = np.eye(3, len(rest))
    linked = loops.linked_states(A, B, C)
    return Hand(A[np.ix_(linked, linked)], B[linked], C[:, linked], closed.dt)


def hertz(period: float, count: int) -> loops.Matrix:
    """Return the frequencies (Hz) of the passivity analysis, up to half the controller's rate."""
    return np.geomspace(MIN_FREQUENCY, 0.499 / period, count)


def power_share(Y: Complex) -> loops.Matrix:
    """Return the smallest share (n,), -1 .. 1, of the exchanged power that a swing takes from the hand; `Y` (n, k, k).

    It is negative if the robot supplies energy to some swing.
    """
    part = 0.5 * (Y + np.conj(np.swapaxes(Y, -1, -2)))
    return np.linalg.eigvalsh(part)[:, 0] / np.linalg.norm(Y, 2, axis=(1, 2))
