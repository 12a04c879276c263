"""Power out of nothing: what the coupling of a motor's shaft and its spring adds to, or takes from, the robot.

Both sides of a coupling compute the power that flows through it, each from what it was given; in the real shaft the two
are one. The difference is energy that the coupling makes: what Benedikt, Watzenig, Zehetner and Hofer ("NEPCE, a nearly
energy-preserving coupling element for weak-coupled problems and co-simulation", Coupled Problems 2013) correct for, and
the residual power of Sadjina, Kyllingstad, Skjong and Pedersen ("Energy conservation and power bonds in
co-simulations", Engineering with Computers 33, 2017). It needs no reference.

Over one step the drive turns by d theta_m against the load that it was given, u:

    W_drive = u d theta_m

The spring takes what moves its motor end. Where it is given a ramp, theta_m goes along it while the torque goes from
tau_load(t_k) to tau_load(t_k+1), by the trapezoid, which is off by the third power of the step:

    W_spring = 1/2 (tau_load(t_k) + tau_load(t_k+1)) (theta_m,end - theta_m,start)

Where it is given one angle for the step, its motor end jumps there at once and then stands still, so that its stored
energy 1/2 k_s d^2 = tau_load^2/(2 k_s) jumps at the link's angle of t_k:

    W_spring = (tau^2 - tau_load(t_k)^2)/(2 k_s),   tau = k_s dead(theta_m - N theta_l(t_k))

The residual is W_spring - W_drive: positive where the coupling creates energy.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.assembly.assemble import Assembly, assemble
from twin.cosim.component import Component
from twin.cosim.port import width
from twin.cosim.simulation import Simulation
from twin.experiment.experiment import Experiment
from twin.robot.sea import dead_zone, deflection, motor_load_torque


@dataclass(frozen=True)
class Residual:
    """Of one joint over a run.

    Attributes:
        mean: of the residual power (W), signed. peak: its largest value of any step (W).
        energy: created (J), signed. throughput: of |W_drive| (J).
    """

    mean: float
    peak: float
    energy: float
    throughput: float


def power_residuals(experiment: Experiment) -> tuple[Residual, Residual, Residual]:
    """Run `experiment` in this process and balance what drives and springs make of it, joint by joint.

    Raises:
        InputRefused: a drive does not fit. ComponentFailed: a component failed.
    """
    with assemble(experiment) as assembly:
        W_drive, W_spring = _work(experiment, assembly)
    created, h = W_spring - W_drive, experiment.cosim.tick
    one, two, three = (
        Residual(
            mean=float(created[:, i].mean() / h),
            peak=float(np.abs(created[:, i]).max() / h),
            energy=float(created[:, i].sum()),
            throughput=float(np.abs(W_drive[:, i]).sum()),
        )
        for i in range(3)
    )
    return one, two, three


def _work(experiment: Experiment, assembly: Assembly) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """W_drive and W_spring of each step and joint, (ticks, 3) each (J)."""
    system, p = assembly.system, experiment.plant
    plant, drives = system.component("plant"), [c for c in system.components if c.name.startswith("drive")]
    # one tick per slice: then the inputs are those of that tick's step
    simulation = Simulation(system, experiment.duration_ticks, slice_ticks=1)
    ramp = any(port.name == "theta_m_start" for port in plant.inputs)
    size = experiment.duration_ticks
    rows = np.empty((size + 1, system.outputs_width))
    load, end, start = np.empty((size, 3)), np.empty((size, 3)), np.empty((size, 3))
    for k in range(size):
        rows[k] = simulation.advance()[0]
        if simulation.failure:
            raise simulation.failure
        load[k] = np.concatenate([_input(simulation, drive, "tau_load") for drive in drives])
        end[k] = _input(simulation, plant, "theta_m")
        start[k] = _input(simulation, plant, "theta_m_start") if ramp else end[k]
    rows[size] = simulation.advance()[0]
    theta_m = np.concatenate([rows[:, system.columns(f"{drive.name}.theta_m")] for drive in drives], axis=1)
    tau_load, theta_l = rows[:, system.columns("plant.tau_load")], rows[:-1, system.columns("plant.theta_l")]
    W_drive = load * np.diff(theta_m, axis=0)
    if ramp:
        return W_drive, 0.5 * (tau_load[:-1] + tau_load[1:]) * (end - start)
    tau = motor_load_torque(p.k_s, np.vectorize(dead_zone)(deflection(end, theta_l, p.N), p.backlash))
    return W_drive, (tau**2 - tau_load[:-1] ** 2) / (2.0 * p.k_s)


def _input(simulation: Simulation, component: Component, name: str) -> NDArray[np.float64]:
    names = [port.name for port in component.inputs]
    first = width(component.inputs[: names.index(name)])
    return simulation.inputs(component)[first : first + component.inputs[names.index(name)].size].copy()
