"""The reference without any coupling: drives and plant as one differential equation, compiled.

A drive here is T_m d omega_m/dt = omega_ref - droop tau_load - omega_m, d theta_m/dt = omega_m: `velocity_servo.fmu`
with its limits out of reach (equations (1) to (4) of its README). T_m = 0 and droop = 0 make `ideal_velocity.fmu`,
whose shaft turns as commanded. Drive and spring exchange theta_m and tau_load at every instant, not once per tick.

scipy integrates the equation from controller tick to controller tick; at a tick the same compiled encoder, estimator
and controller run as in the co-simulation. So only the coupling can make a difference.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import memory_of, port_slices, record, width
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.build import belief, controller, plant_parameters, shafts, surface_motions
from twin.robot.assembly.drives import ONLY_PART, DrivePlan
from twin.robot.controller.controller import Estimator
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import NO_MOTION, OUTPUTS_RECORD, PLANT_OUTPUTS, outputs_near, rest_state
from twin.robot.plant.contact import apex_frame
from twin.robot.plant.dynamics import INITIAL_ANCHORS, PARAMETERS_RECORD, STATE_SIZE, PlantParameters, derivative
from twin.robot.plant.encoder import Encoder
from twin.robot.plant.equations import PlantEquations
from twin.robot.plant.joints import ANCHOR_SIZE

_STEP_SIGNATURE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
_EQUATIONS_RECORD = record(
    parameters=PARAMETERS_RECORD, **dict.fromkeys(("T_m", "droop", "omega_ref", "theta_m", "omega_m"), "3f8"),
    **dict.fromkeys(("dtheta_m", "domega_m"), "3f8"), x=("f8", (STATE_SIZE,)), dx=("f8", (STATE_SIZE,)),
    anchors=("f8", (3, ANCHOR_SIZE)), y=OUTPUTS_RECORD,
)  # fmt: skip
"""Constants, command, state, derivative; anchors of dry friction, which are unused; outputs of the plant."""
# 1e-10 m, m/s and rad correspond to 1e-6 N; the bristle's rate jumps whenever friction sticks or slips, and 1e-8 m of
# it correspond to 4e-5 N
RTOL, ATOL = 1e-9, np.array([1e-10] * 12 + [1e-8] * 2)


class ComponentStepper:
    """A component outside any system; raises `ValueError` for wrong inputs, `ComponentFailed` for a bad status."""

    def __init__(self, component: Component):
        self.component = component
        self._step = _STEP_SIGNATURE(component.step_address)
        self._y = component.initial_outputs.copy()
        self._places = port_slices(component.outputs)

    def __call__(self, u: NDArray[np.float64], t: float = 0.0, h: float = 2e-3) -> NDArray[np.float64]:
        u = np.ascontiguousarray(u, dtype=float)
        if len(u) != width(self.component.inputs):
            raise ValueError(f"{self.component.name}: {len(u)} inputs; expected {width(self.component.inputs)}")
        status = self._step(self.component.self_address, t, h, u.ctypes.data, self._y.ctypes.data)
        # 1 is a warning
        if status not in (0, 1):
            raise ComponentFailed(f"{self.component.name} {self.component.explain(status)}")
        return self._y.copy()

    def outputs_by_port(
        self, u: NDArray[np.float64] | Mapping[str, NDArray[np.float64]], t: float = 0.0, h: float = 2e-3
    ) -> dict[str, NDArray[np.float64]]:
        """Step the component once and return its outputs by port; a mapping may have other entries."""
        if isinstance(u, Mapping):
            u = np.concatenate([np.atleast_1d(u[port.name]) for port in self.component.inputs])
        y = self(u, t, h)
        return {name: y[place] for name, place in self._places.items()}


@entry("nothing", _EQUATIONS_RECORD)
def _derive(m):
    outputs_near(m.parameters, m.x, m.theta_m, NO_MOTION, NO_MOTION, apex_frame(m.parameters), m.anchors, m.y)
    for leg in range(3):
        target = m.omega_ref[leg] - m.droop[leg] * m.y.tau_load[leg]
        if m.T_m[leg] > 0.0:
            m.dtheta_m[leg] = m.omega_m[leg]
            m.domega_m[leg] = (target - m.omega_m[leg]) / m.T_m[leg]
        else:
            m.dtheta_m[leg], m.domega_m[leg] = target, 0.0
    derivative(m.parameters, m.x, m.theta_m, NO_MOTION, NO_MOTION, m.dx)


class CoupledEquations:
    """Drives and plant as one differential equation, with the surface at rest.

    The state is x = (theta_m (3), omega_m (3), the plant's state (8)), SI.

    Args:
        T_m, droop: time constant (s) and droop (rad/s per N m) of each drive, (3,) each.
    """

    def __init__(self, parameters: PlantParameters, T_m: ArrayLike, droop: ArrayLike):
        self._memory = memory_of(_EQUATIONS_RECORD, parameters=tuple(parameters), T_m=T_m, droop=droop)

    def derivative(self, omega_ref: ArrayLike, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return dx/dt (14,) of drives and plant with the command `omega_ref` (3,) in rad/s."""
        m = self._memory
        m["omega_ref"], m["theta_m"], m["omega_m"] = omega_ref, x[:3], x[3:6]
        m["x"], m["anchors"] = x[6:], INITIAL_ANCHORS
        _derive(m)
        return np.concatenate([m[name][0] for name in ("dtheta_m", "domega_m", "dx")])


@dataclass(frozen=True)
class Servos:
    """Constants of three drives with known equations, and the limits of these equations; (3,) each.

    Attributes:
        T_m: time constant (s).
        droop: rad/s per N m.
        omega_max: limit of the command (rad/s).
        alpha_max: rad/s2.
        tau_max: limit of the machine's torque (N m).
        J_m: kg m2.
    """

    T_m: NDArray[np.float64]
    droop: NDArray[np.float64]
    omega_max: NDArray[np.float64]
    alpha_max: NDArray[np.float64]
    tau_max: NDArray[np.float64]
    J_m: NDArray[np.float64]


def servos(plans: tuple[DrivePlan, ...]) -> Servos | None:
    """Return the constants of drives whose equations are known (velocity_servo, ideal_velocity), else None."""
    found: list[tuple[float, ...]] = []
    for plan in plans:
        fmu, table = plan.parts.get(ONLY_PART), plan.table
        plain = table.gear_ratio == 1.0 and table.sign == 1 and plan.is_bare and table.substeps == 1
        name = fmu.model.modelName if fmu is not None and plain and plan.axes == 1 else ""
        if name == "ideal_velocity":
            found.append((0.0, 0.0, np.inf, np.inf, np.inf, 0.0))
        elif name == "velocity_servo" and fmu is not None:
            given = {v: float(fmu.variables[v].start) for v in Servos.__annotations__}
            given |= {v.name: value for v, value in plan.settings[ONLY_PART] if isinstance(value, float)}
            found.append(tuple(given[v] for v in Servos.__annotations__))
        else:
            return None
    return Servos(*np.array(found).T)


def has_monolithic_form(experiment: Experiment) -> bool:
    """Whether the experiment has no motion, change, delay, noise, monitor or friction, so that one equation serves."""
    return not (
        experiment.tasks
        or experiment.faults
        or experiment.changes
        or surface_motions(experiment.contact)
        or experiment.monitor
        or experiment.stand_ins
        or experiment.controller.delay_ticks
        or experiment.controller.bus_delay_ticks
        or experiment.plant.encoder_latency
        or experiment.plant.joint_friction
        or experiment.plant.spring_hysteresis
        or experiment.plant.motor_noise
        or experiment.plant.joint_noise
    )


def monolithic_rows(experiment: Experiment, drives: Servos) -> dict[str, NDArray[np.float64]]:
    """Run an experiment as one differential equation, without any coupling error.

    Returns:
        Outputs of the plant by "plant.port", and "theta_m", "omega_m" and "omega_ref" (n, 3), per controller tick.
    """
    parameters, p = plant_parameters(experiment.plant, experiment.contact), experiment.plant
    x_plant, theta_m = rest_state(parameters, experiment.start)
    x = np.concatenate([theta_m, np.zeros(3), x_plant])
    encoder = ComponentStepper(Encoder(*shafts(p)))
    estimator = ComponentStepper(Estimator(belief(experiment), experiment.controller.gravity_compensation))
    law = ComponentStepper(controller(experiment))
    plant, coupled = PlantEquations(parameters), CoupledEquations(parameters, drives.T_m, drives.droop)
    T_s = experiment.controller_ticks * experiment.cosim.tick
    y = np.empty(experiment.duration_ticks // experiment.controller_ticks + 1, dtype=OUTPUTS_RECORD)
    shaft = np.empty((len(y), 9))
    for k, row in enumerate(y):
        shaft[k, :6] = x[:6]
        y[k] = plant.outputs(x[6:], x[:3])[0]
        estimate = estimator.outputs_by_port(encoder.outputs_by_port({"theta_m": x[:3], "theta_l": row["theta_l"]}))
        omega_ref = shaft[k, 6:] = law.outputs_by_port(estimate, k * T_s, T_s)["omega_ref"]

        def rate(_t: float, x: NDArray[np.float64], omega_ref: NDArray[np.float64] = omega_ref) -> NDArray[np.float64]:
            return coupled.derivative(omega_ref, x)

        solver = DOP853(rate, 0.0, x, T_s, first_step=T_s, rtol=RTOL, atol=ATOL)
        while solver.status == "running":
            solver.step()
        x = solver.y
        x[6:] = plant.settle_bristle(x[6:])
    rows = {f"plant.{port.name}": np.reshape(y[port.name], (len(y), -1)) for port in PLANT_OUTPUTS}
    return rows | {"theta_m": shaft[:, :3], "omega_m": shaft[:, 3:6], "omega_ref": shaft[:, 6:]}


def within_limits(rows: dict[str, NDArray[np.float64]], drives: Servos) -> bool:
    """Whether the servos kept their limits at each command, after which a servo only relaxes."""
    lag = rows["omega_ref"] - drives.droop * rows["plant.tau_load"] - rows["omega_m"]
    alpha = np.abs(np.divide(lag, drives.T_m, out=np.zeros_like(lag), where=drives.T_m > 0.0))
    tau_motor = np.abs(rows["plant.tau_load"]) + drives.J_m * alpha
    inside = (np.abs(rows["omega_ref"]) < drives.omega_max) & (alpha < drives.alpha_max) & (tau_motor < drives.tau_max)
    return bool(np.all(inside))
