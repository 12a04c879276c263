"""The reference without any coupling: drives and plant as one differential equation.

A drive here is T_m d omega_m/dt = omega_ref - droop tau_load - omega_m, d theta_m/dt = omega_m: `velocity_servo.fmu`
with its limits out of reach (equations (1) to (4) of its README). T_m = 0 and droop = 0 make `ideal_velocity.fmu`,
whose shaft turns as commanded. Drive and spring exchange theta_m and tau_load at every instant, not once per tick.

scipy integrates that from controller tick to controller tick; at a tick the same compiled encoder, estimator and
controller run as in the co-simulation. What is left to differ is the coupling alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from twin.controller.estimator import Estimator
from twin.experiment.experiment import Experiment
from twin.plant.component import OUTPUTS
from twin.plant.encoder import Encoder
from twin.plant.equations import MOTION, Equations
from twin.plant.equilibrium import resting
from twin.runs.assembly.beliefs import belief
from twin.runs.assembly.computer import controller
from twin.runs.assembly.drives import ALONE, DrivePlan
from twin.runs.assembly.true_parameters import plant_parameters, shafts, surface_motions
from twin.studies.converge.by_hand import Sampled
from twin.studies.converge.coupled import Coupled

# 1e-10 m, m/s and rad are 1e-6 N; the bristle's rate jumps whenever friction sticks or slips, and 1e-8 m of it are
# 4e-5 N
RTOL, ATOL = 1e-9, np.array([1e-10] * 12 + [1e-8] * 2)


@dataclass(frozen=True)
class Servos:
    """The constants of `Coupled`, and the limits within which it is the drives' equation; (3,) each.

    Attributes:
        T_m: s.
        droop: rad/s per N m.
        omega_max: of the command, rad/s.
        alpha_max: rad/s2.
        tau_max: of the machine, N m.
        J_m: kg m2.
    """

    T_m: NDArray[np.float64]
    droop: NDArray[np.float64]
    omega_max: NDArray[np.float64]
    alpha_max: NDArray[np.float64]
    tau_max: NDArray[np.float64]
    J_m: NDArray[np.float64]


def servos(plans: tuple[DrivePlan, ...]) -> Servos | None:
    """What stands behind three joints, if its equations are known here: velocity_servo.fmu or ideal_velocity.fmu."""
    found: list[tuple[float, ...]] = []
    for plan in plans:
        fmu, table = plan.parts.get(ALONE), plan.table
        plain = table.gear_ratio == 1.0 and table.sign == 1 and plan.is_bare and table.substeps == 1
        name = fmu.model.modelName if fmu is not None and plain and plan.axes == 1 else ""
        if name == "ideal_velocity":
            found.append((0.0, 0.0, np.inf, np.inf, np.inf, 0.0))
        elif name == "velocity_servo" and fmu is not None:
            given = {v: float(fmu.variables[v].start) for v in Servos.__annotations__}
            given |= {v.name: value for v, value in plan.settings[ALONE] if isinstance(value, float)}
            found.append(tuple(given[v] for v in Servos.__annotations__))
        else:
            return None
    return Servos(*np.array(found).T)


def applies(experiment: Experiment) -> bool:
    """Whether `monolithic_rows` knows all that goes on besides the drives: nothing moves, changes, delays, watches, and
    no dry friction remembers where it was."""
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


def monolithic_rows(
    experiment: Experiment, drives: Servos, rtol: float = RTOL, atol: NDArray[np.float64] = ATOL
) -> dict[str, NDArray[np.float64]]:
    """Run `experiment`, to which `applies`, without co-simulating it.

    Args:
        experiment: its [cosim] plays no role.
        drives: behind the joints.
        rtol, atol: tolerances of the solver, (14,) as the state of `Coupled`.

    Returns:
        Outputs of the plant by "plant.port", and "theta_m", "omega_m" and "omega_ref" (n, 3): one row per tick of the
        controller.
    """
    parameters, p = plant_parameters(experiment.plant, experiment.contact), experiment.plant
    x_plant, theta_m = resting(parameters, experiment.start)
    x = np.concatenate([theta_m, np.zeros(3), x_plant])
    encoder = Sampled(Encoder(*shafts(p)))
    estimator = Sampled(Estimator(belief(experiment), experiment.controller.gravity_compensation))
    law = Sampled(controller(experiment))
    plant, coupled = Equations(parameters), Coupled(parameters, drives.T_m, drives.droop)
    T_s = experiment.controller_ticks * experiment.cosim.tick
    y = np.empty(experiment.duration_ticks // experiment.controller_ticks + 1, dtype=MOTION)
    shaft = np.empty((len(y), 9))
    for k, row in enumerate(y):
        shaft[k, :6] = x[:6]
        y[k] = plant.outputs(x[6:], x[:3])[0]
        estimate = estimator.named(encoder.named({"theta_m": x[:3], "theta_l": row["theta_l"]}))
        omega_ref = shaft[k, 6:] = law.named(estimate, k * T_s, T_s)["omega_ref"]

        def rate(_t: float, x: NDArray[np.float64], omega_ref: NDArray[np.float64] = omega_ref) -> NDArray[np.float64]:
            return coupled.derivative(omega_ref, x)

        solver = DOP853(rate, 0.0, x, T_s, first_step=T_s, rtol=rtol, atol=atol)
        while solver.status == "running":
            solver.step()
        x = solver.y
        x[6:] = plant.settled(x[6:])
    rows = {f"plant.{port.name}": np.reshape(y[port.name], (len(y), -1)) for port in OUTPUTS}
    return rows | {"theta_m": shaft[:, :3], "omega_m": shaft[:, 3:6], "omega_ref": shaft[:, 6:]}


def within_limits(rows: dict[str, NDArray[np.float64]], drives: Servos) -> bool:
    """Whether the servos stayed what `Coupled` says, at every tick of the controller.

    That is where acceleration and torque are largest: between two commands a servo only relaxes.
    """
    lag = rows["omega_ref"] - drives.droop * rows["plant.tau_load"] - rows["omega_m"]
    alpha = np.abs(np.divide(lag, drives.T_m, out=np.zeros_like(lag), where=drives.T_m > 0.0))
    tau_motor = np.abs(rows["plant.tau_load"]) + drives.J_m * alpha
    inside = (np.abs(rows["omega_ref"]) < drives.omega_max) & (alpha < drives.alpha_max) & (tau_motor < drives.tau_max)
    return bool(np.all(inside))
