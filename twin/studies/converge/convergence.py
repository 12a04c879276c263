"""Step halving: every coupling at several ticks against one reference.

The ways in which drives and plant may exchange their values, from the simplest on.

What couplings are compared with.

An experiment without what snaps to a tick or a count, so that what is left to differ is the coupling. An error in the
time of an event is of order one in the tick whatever the coupling; an encoder's count is as large as many a coupling
error; and a trigger that a count decides comes whole periods earlier or later.

How fast an error falls with the tick.

What is compared: the signals on either side of the coupling and the force that the twin is for.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.interpolation import Inputs, Scheme
from twin.kernel.cosim.observers import Observer, TickEvent, simulate
from twin.kernel.cosim.port import by_port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.roles import refuse_other_parts
from twin.robot.experiment.experiment import Experiment, exactly_measured, shortened, with_cosim, with_plant
from twin.robot.mechanism.statics import G_ACCELERATION, dead_zone, deflection, motor_load_torque
from twin.robot.plant.dynamics import series_share, spring_stiffness
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.command import Say, Steps, silent
from twin.studies.converge.monolith import ATOL, applies, monolithic_rows, servos, within_limits


@dataclass(frozen=True)
class Signal:
    """name: as in recordings. unit, scale: for people, and how many of these are one SI unit."""

    name: str
    unit: str
    scale: float = 1.0


SIGNALS = (
    Signal("F_z", "mN", 1e3),
    Signal("p_B", "um", 1e6),
    Signal("theta_m", "urad", 1e6),
    Signal("tau_load", "uN m", 1e6),
)
FORCE, POSITION = SIGNALS[:2]

Samples = dict[str, NDArray[np.float64]]
"""By name of the signal, (n, values): one row per tick of the controller."""


def chosen(plant: Samples, theta_m: NDArray[np.float64]) -> Samples:
    """The signals out of the plant's outputs, by "plant.port", and the motor angles (n, 3)."""
    return {
        "F_z": -plant["plant.F_ee_B"][:, 2:],
        "p_B": plant["plant.p_B"],
        "theta_m": theta_m,
        "tau_load": plant["plant.tau_load"],
    }


def sampled_run(experiment: Experiment) -> tuple[Samples, float]:
    """The signals of `experiment` run in this process, and wall time per simulated time of the master (1)."""
    run = Trace(experiment.controller_ticks)
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run]).completed()
    plant = {key: run[key] for key in ("plant.F_ee_B", "plant.p_B", "plant.tau_load")}
    simulated = experiment.duration_ticks * experiment.cosim.tick
    return chosen(plant, run.of_drives("theta_m")), done.stepping / simulated


def largest_errors(samples: Samples, reference: Samples) -> dict[str, float]:
    """The largest |difference| of any value at any time: nothing can cancel."""
    return {name: float(np.abs(values - reference[name]).max()) for name, values in samples.items()}


UNEVEN = 0.3
"""Slopes of neighbouring pairs that differ by more belong to no power of the tick."""
FEWEST = 3
"""So many errors above the floor make a slope that can contradict itself."""
LEAST = 0.5
"""A smaller slope is no order: what is left is not the coupling's error."""


class OrderFinding(StrEnum):
    """What can be said of an order."""

    SMOOTH = "smooth"
    NOT_SMOOTH = "not smooth"
    NOT_FALLING = "does not fall with the tick"
    AT_FLOOR = "at the reference's own accuracy"
    UNSTABLE = "not stable at every tick"


@dataclass(frozen=True)
class Order:
    """p in error = C tick^p; `slope` is None where it would mean nothing, and `finding` says why."""

    slope: float | None
    finding: OrderFinding


def observed_order(ticks: ArrayLike, errors: ArrayLike, floor: float) -> Order:
    """Least squares in log-log over the errors that say something of the coupling.

    Args:
        ticks: s, (n,).
        errors: >= 0, infinite where the run failed, (n,).
        floor: errors up to ten times this are left out: there the reference's own error is more than a tenth.
    """
    h, e = np.asarray(ticks, dtype=float), np.asarray(errors, dtype=float)
    if not np.all(np.isfinite(e)):
        return Order(None, OrderFinding.UNSTABLE)
    clear = e > 10.0 * floor
    if np.count_nonzero(clear) < FEWEST:
        return Order(None, OrderFinding.AT_FLOOR)
    by_tick = np.argsort(h[clear])
    log_h, log_e = np.log(h[clear][by_tick]), np.log(e[clear][by_tick])
    pairs = np.diff(log_e) / np.diff(log_h)
    slope = float(np.polyfit(log_h, log_e, 1)[0])
    if slope < LEAST:
        return Order(None, OrderFinding.NOT_FALLING)
    return Order(slope, OrderFinding.NOT_SMOOTH if np.ptp(pairs) > UNEVEN else OrderFinding.SMOOTH)


@dataclass(frozen=True)
class PowerResidual:
    """Of one joint over a run.

    Attributes:
        mean: of the residual power (W), signed.
        peak: its largest value of any step (W).
        energy: created (J), signed.
        throughput: of |W_drive| (J).
    """

    mean: float
    peak: float
    energy: float
    throughput: float

    JSON_KEYS = "mean_W=mean peak_W=peak created_J=energy throughput_J=throughput"


def power_residuals(experiment: Experiment) -> tuple[PowerResidual, PowerResidual, PowerResidual]:
    """Run `experiment` in this process and balance what drives and springs make of it, joint by joint."""
    with assemble(experiment) as assembly:
        W_drive, W_spring = _work(experiment, assembly)
    created, h = W_spring - W_drive, experiment.cosim.tick
    one, two, three = (
        PowerResidual(
            mean=float(created[:, i].mean() / h),
            peak=float(np.abs(created[:, i]).max() / h),
            energy=float(created[:, i].sum()),
            throughput=float(np.abs(W_drive[:, i]).sum()),
        )
        for i in range(3)
    )
    return one, two, three


class _Inputs(Observer):
    """What drives and plant were given in each step: sees the inputs of a slice's last step, so slices are one tick.

    Attributes:
        load: of the drives, (ticks, 3) N m.
        end, start: of the plant's motor ends, (ticks, 3) rad; the same angle where it is given only one.
    """

    def begin(self, simulation: Simulation) -> None:
        components = simulation.system.components
        self._simulation = simulation
        self._plant = simulation.system.component("plant")
        self._drives = [component for component in components if component.name.startswith("drive")]
        self.ramp = any(port.name == "theta_m_start" for port in self._plant.inputs)
        self.load, self.end, self.start = (np.empty((simulation.last_tick, 3)) for _ in range(3))

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        # in the last tick no step is made
        if first < len(self.load):
            self.load[first] = np.concatenate([self._input(drive, "tau_load") for drive in self._drives])
            self.end[first] = self._input(self._plant, "theta_m")
            self.start[first] = self._input(self._plant, "theta_m_start") if self.ramp else self.end[first]

    def _input(self, component: Component, name: str) -> NDArray[np.float64]:
        return by_port(component.inputs, self._simulation.inputs(component))[name]


def _work(experiment: Experiment, assembly: Assembly) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """W_drive and W_spring of each step and joint, (ticks, 3) each (J)."""
    run, inputs, p = Trace(), _Inputs(), plant_parameters(experiment.plant, experiment.contact)
    simulate(assembly, experiment.duration_ticks, [run, inputs], slice_ticks=1).completed()
    tau_load, theta_l = run["plant.tau_load"], run["plant.theta_l"][:-1]
    W_drive = inputs.load * np.diff(run.of_drives("theta_m"), axis=0)
    if inputs.ramp:
        return W_drive, 0.5 * (tau_load[:-1] + tau_load[1:]) * (inputs.end - inputs.start)
    k_s = spring_stiffness(p, 0) * series_share(p, 0)
    tau = motor_load_torque(
        k_s, np.vectorize(dead_zone, otypes=[float])(deflection(inputs.end, theta_l, p.N), p.backlash)
    )
    return W_drive, (tau**2 - tau_load[:-1] ** 2) / (2.0 * k_s)


@dataclass(frozen=True)
class Coupling:
    """Scheme, inputs and iterations of `twin.kernel.cosim.system.System`."""

    scheme: Scheme
    inputs: Inputs
    iterations: int = 1

    @property
    def name(self) -> str:
        """In the words of [cosim]; "2 times": iterations = 2."""
        again = f", {self.iterations} times" if self.iterations > 1 else ""
        return f"{self.scheme}, {self.inputs}{again}"

    @property
    def expected_order(self) -> int:
        """Where everything is smooth: the error of a value held from one end, or of the middle of a line."""
        return 1 if self.inputs == "hold" else 2

    def of(self, experiment: Experiment, tick: float) -> Experiment:
        """`experiment` coupled so at `tick` (s)."""
        return with_cosim(experiment, tick=tick, scheme=self.scheme, inputs=self.inputs, iterations=self.iterations)


COUPLINGS = (
    Coupling("gauss_seidel", "hold"),
    Coupling("jacobi", "hold"),
    Coupling("gauss_seidel", "linear"),
    Coupling("jacobi", "linear"),
    Coupling("gauss_seidel", "linear", iterations=2),
)
FINEST = Coupling("gauss_seidel", "linear")
"""The most accurate one that every drive can."""


FINER = 32
"""The finest run's steps per tick of the experiment: 1/16 of the error of order two at an eighth of the tick."""


@dataclass(frozen=True)
class ReferenceRun:
    """samples: of the controller's ticks. floor: how far they may be off, by signal. meaning: where they come from."""

    samples: Samples
    floor: dict[str, float]
    meaning: str

    @property
    def pressed(self) -> bool:
        """Whether the robot presses on anything at any time."""
        return bool(np.any(self.samples[FORCE.name]))


def reference_of(experiment: Experiment) -> ReferenceRun:
    """Without any coupling where the drives' equations are known, else the finest co-simulation."""
    with assemble(experiment) as assembly:
        drives = servos(assembly.drives)
    why = "no equations of this drive are known here"
    if drives is not None and not applies(experiment):
        why = "the monolithic one knows no moving bodies, delays, changes or dry friction"
    elif drives is not None:
        rows = monolithic_rows(experiment, drives)
        if within_limits(rows, drives):
            meaning = "monolithic: drives and plant as one equation"
            return ReferenceRun(chosen(rows, rows["theta_m"]), _solver_floor(experiment), meaning)
        why = "a drive reaches a limit"
    tick = experiment.cosim.tick
    finest, _ = sampled_run(FINEST.of(experiment, tick / FINER))
    coarser, _ = sampled_run(FINEST.of(experiment, 2.0 * tick / FINER))
    # of order two the finer one is off by a third of what it differs from the coarser one
    floor = {name: error / 3.0 for name, error in largest_errors(coarser, finest).items()}
    meaning = f"the finest run: {FINEST.name}, {1e3 * tick / FINER:g} ms; {why}"
    return ReferenceRun(finest, floor, meaning)


def _solver_floor(experiment: Experiment) -> dict[str, float]:
    """The solver's tolerance of a position (m) or angle (rad), and what it is in a force and a torque."""
    tolerance = float(np.min(ATOL))
    p = plant_parameters(experiment.plant, experiment.contact)
    # bristle and surface together see an error of the position
    return {
        "F_z": p.K * tolerance,
        "p_B": tolerance,
        "theta_m": tolerance,
        "tau_load": p.k_s * (1.0 + p.N) * tolerance,
    }


OUT_OF_REACH = 1e9
"""A trigger force (N) that nothing reaches."""


@dataclass(frozen=True)
class Smooth:
    """An experiment and what was taken out of it, one phrase each."""

    experiment: Experiment
    changes: tuple[str, ...]


def comparable(experiment: Experiment) -> Smooth:
    """With exact encoders and a force loop that starts when it did, not when a count says so."""
    if experiment.faults:
        raise InputRefused(f"{experiment.name}: has faults, whose effect is no coupling error; remove [[fault]]")
    if experiment.tasks:
        raise InputRefused(
            f"{experiment.name}: its tasks change phase at the measured force, so two runs are not comparable "
            "in time; choose an experiment with a [reference]"
        )
    p = experiment.plant
    if p.spring_hysteresis or p.spring_stop is not None:
        key = "spring_hysteresis" if p.spring_hysteresis else "spring_stop_deg"
        raise InputRefused(
            f"{experiment.name}: [plant] {key}: the energy that a coupling makes is known only for springs "
            "without hysteresis and stop; remove it from [plant]"
        )
    changes = ["encoders exact"]
    smooth = exactly_measured(experiment)
    refuse_other_parts(experiment, "a study of the coupling", ("controller", "estimator"))
    if experiment.monitor is not None:
        # it believes in the encoders of the robot
        smooth = replace(smooth, monitor=None)
        changes.append("no safety monitor")
    triggered = np.flatnonzero(run_in_memory(experiment, only=["controller.triggered"]).held("controller.triggered"))
    if len(triggered) and experiment.controller.force.trigger is not None:
        when = float(triggered[0] * experiment.cosim.tick)
        force = experiment.controller.force.model_copy(update={"trigger": OUT_OF_REACH, "trigger_time": when})
        smooth = replace(smooth, controller=smooth.controller.model_copy(update={"force": force}))
        changes.append(f"force loop on at {when:g} s, not by force")
    return Smooth(smooth, tuple(changes))


def smoothed(smooth: Smooth) -> Smooth:
    """Without backlash and friction, too: spring and contact then change direction without an event."""
    experiment = with_plant(smooth.experiment, backlash=0.0, joint_friction=0.0)
    contact = experiment.contact.model_copy(update={"friction": 0.0})
    return Smooth(replace(experiment, contact=contact), (*smooth.changes, "no backlash", "no friction under the head"))


SHARES = (2.0, 1.0, 0.5, 0.25, 0.125)
"""Ticks to run, in ticks of the experiment; those that periods or drives do not fit are left out."""


@dataclass(frozen=True)
class TickPoint:
    """One run: tick (s), largest error by signal (SI; infinite if it failed), wall time per simulated time."""

    tick: float
    errors: dict[str, float]
    cost: float

    JSON_KEYS = "tick_s=tick cost_s_per_s=cost largest_error=errors"


@dataclass(frozen=True)
class CouplingSeries:
    """One coupling, from the longest tick to the shortest.

    Attributes:
        residuals: of the three joints at the experiment's own tick; none if that run failed.
    """

    coupling: Coupling
    points: tuple[TickPoint, ...]
    orders: dict[str, Order]
    residuals: tuple[PowerResidual, ...]

    JSON_KEYS = "coupling points order=orders power=residuals"


@dataclass(frozen=True)
class CouplingChoice:
    """A coupling at a tick that keeps the force within the tolerance."""

    coupling: Coupling
    point: TickPoint

    JSON_KEYS = "coupling tick_s=point.tick error_N=point.errors.F_z"


@dataclass(frozen=True)
class CouplingStudy:
    """What came of it.

    Attributes:
        duration, tick: as it was run (s).
        left_out: why, by the coupling's name.
        tolerance: of the force (N).
        choice: None: no run met it, or nothing is pressed.
        resolution: step of the scale's display (N); None: there is no scale.
    """

    name: str
    duration: float
    tick: float
    coupling: Coupling
    changes: tuple[str, ...]
    reference: ReferenceRun
    series: tuple[CouplingSeries, ...]
    left_out: dict[str, str]
    tolerance: float
    choice: CouplingChoice | None
    resolution: float | None = None

    JSON_KEYS = (
        "experiment=name duration_s=duration tick_s=tick coupling changes reference=reference.meaning "
        "floor=reference.floor tolerance_N=tolerance recommended=choice series left_out"
    )

    @property
    def judged(self) -> Signal:
        """What the study is about: the force; the position in the air, where no coupling can be wrong about a force."""
        return FORCE if self.reference.pressed else POSITION


def convergence(
    experiment: Experiment,
    tolerance: float = 0.005,
    duration: float | None = None,
    smooth: bool = False,
    say: Say = silent,
) -> CouplingStudy:
    """Run `experiment` in every coupling and at every tick, and say which is good enough.

    Args:
        tolerance: of the pressing force (N).
        duration: of each run (s); None: the whole experiment.
        smooth: take backlash and friction out as well.
    """
    steps = Steps(say, 1 + len(COUPLINGS))
    steps.next("reference")
    whole = comparable(experiment)
    cut = Smooth(shortened(whole.experiment, duration) if duration else whole.experiment, whole.changes)
    used = smoothed(cut) if smooth else cut
    reference = reference_of(used.experiment)
    series: list[CouplingSeries] = []
    left_out: dict[str, str] = {}
    for coupling in COUPLINGS:
        steps.next(coupling.name)
        try:
            series.append(_series(used.experiment, coupling, reference))
        except InputRefused as why:
            # what is never refused is why the experiment itself cannot be run
            if coupling == COUPLINGS[0]:
                raise
            left_out[coupling.name] = str(why)
    cosim = experiment.cosim
    return CouplingStudy(
        name=experiment.name,
        duration=used.experiment.duration_ticks * cosim.tick,
        tick=cosim.tick,
        coupling=Coupling(cosim.scheme, cosim.inputs, cosim.iterations),
        changes=used.changes,
        reference=reference,
        series=tuple(series),
        left_out=left_out,
        tolerance=tolerance,
        choice=recommended(series, tolerance) if reference.pressed else None,
        resolution=experiment.scale.resolution * G_ACCELERATION if experiment.scale else None,
    )


def recommended(series: list[CouplingSeries], tolerance: float) -> CouplingChoice | None:
    """The longest tick from which on some coupling keeps the force within `tolerance` (N), and the simplest that does.

    At every shorter tick it has to as well: an error that is small at one tick only is luck. Couplings are in the order
    of their simplicity, which is also that of their cost; and unlike measured times the order is the same on every
    machine.
    """
    ticks = sorted({point.tick for one in series for point in one.points}, reverse=True)
    for tick in ticks:
        for one in series:
            for point in one.points:
                shorter = [other for other in one.points if other.tick <= tick]
                if point.tick == tick and all(other.errors[FORCE.name] <= tolerance for other in shorter):
                    return CouplingChoice(one.coupling, point)
    return None


def _series(experiment: Experiment, coupling: Coupling, reference: ReferenceRun) -> CouplingSeries:
    points = tuple(_points(experiment, coupling, reference))
    ticks = [point.tick for point in points]
    orders = {
        signal.name: observed_order(
            ticks, [point.errors[signal.name] for point in points], reference.floor[signal.name]
        )
        for signal in SIGNALS
    }
    own = coupling.of(experiment, experiment.cosim.tick)
    ran = any(point.tick == own.cosim.tick and np.isfinite(point.cost) for point in points)
    return CouplingSeries(coupling, points, orders, power_residuals(own) if ran else ())


def _points(experiment: Experiment, coupling: Coupling, reference: ReferenceRun) -> Iterator[TickPoint]:
    for share in SHARES:
        try:
            varied = coupling.of(experiment, share * experiment.cosim.tick)
            samples, cost = sampled_run(varied)
        except InputRefused:
            # at the experiment's own tick it is the coupling that does not fit, not the tick
            if share == 1.0:
                raise
            continue
        except ComponentFailed:
            yield TickPoint(share * experiment.cosim.tick, {signal.name: np.inf for signal in SIGNALS}, np.inf)
            continue
        yield TickPoint(varied.cosim.tick, largest_errors(samples, reference.samples), cost)
