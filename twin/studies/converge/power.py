"""Power that a coupling creates numerically, joint by joint."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.observers import Observer, TickEvent, simulate
from twin.kernel.cosim.port import by_port
from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.statics import dead_zone, deflection, motor_load_torque
from twin.robot.plant.dynamics import series_share, spring_stiffness
from twin.robot.run.trace import Trace


@dataclass(frozen=True)
class PowerResidual:
    """Energy that a coupling creates numerically at one joint over a run.

    Attributes:
        mean: mean residual power (W), signed.
        peak: largest residual power of a step (W).
        energy: created energy (J), signed.
        throughput: sum of |W_drive| (J).
    """

    mean: float
    peak: float
    energy: float
    throughput: float

    JSON_KEYS = "mean_W=mean peak_W=peak created_J=energy throughput_J=throughput"


def power_residuals(experiment: Experiment) -> tuple[PowerResidual, ...]:
    """Run an experiment in this process and balance the energy of drives and springs, joint by joint."""
    with assemble(experiment) as assembly:
        W_drive, W_spring = _work(experiment, assembly)
    created, h = W_spring - W_drive, experiment.cosim.tick
    return tuple(
        PowerResidual(
            mean=float(created[:, i].mean() / h),
            peak=float(np.abs(created[:, i]).max() / h),
            energy=float(created[:, i].sum()),
            throughput=float(np.abs(W_drive[:, i]).sum()),
        )
        for i in range(3)
    )


class _Inputs(Observer):
    """Observer of the inputs of drives and plant in each step; slices must be one tick long.

    Attributes:
        load: load of the drives, (ticks, 3) N m.
        end, start: motor angles at the end and start of the plant's step, (ticks, 3) rad; equal if it has only one.
    """

    def begin(self, simulation: Simulation) -> None:
        components = simulation.system.components
        self._simulation = simulation
        self._plant = simulation.system.component("plant")
        self._drives = [component for component in components if component.name.startswith("drive")]
        self.ramp = any(port.name == "theta_m_start" for port in self._plant.inputs)
        self.load, self.end, self.start = (np.empty((simulation.last_tick, 3)) for _ in range(3))

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        # no step follows the last tick
        if first < len(self.load):
            self.load[first] = np.concatenate([self._input(drive, "tau_load") for drive in self._drives])
            self.end[first] = self._input(self._plant, "theta_m")
            self.start[first] = self._input(self._plant, "theta_m_start") if self.ramp else self.end[first]

    def _input(self, component: Component, name: str) -> NDArray[np.float64]:
        return by_port(component.inputs, self._simulation.inputs(component))[name]


def _work(experiment: Experiment, assembly: Assembly) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the work of drives and springs in each step and joint, (ticks, 3) each (J)."""
    run, inputs, p = Trace(), _Inputs(), plant_parameters(experiment.plant, experiment.contact)
    simulate(assembly, experiment.duration_ticks, [run, inputs], slice_ticks=1).require_success()
    tau_load, theta_l = run["plant.tau_load"], run["plant.theta_l"][:-1]
    W_drive = inputs.load * np.diff(run.of_drives("theta_m"), axis=0)
    if inputs.ramp:
        return W_drive, 0.5 * (tau_load[:-1] + tau_load[1:]) * (inputs.end - inputs.start)
    k_s = spring_stiffness(p, 0) * series_share(p, 0)
    tau = motor_load_torque(
        k_s, np.vectorize(dead_zone, otypes=[float])(deflection(inputs.end, theta_l, p.N), p.backlash)
    )
    return W_drive, (tau**2 - tau_load[:-1] ** 2) / (2.0 * k_s)
