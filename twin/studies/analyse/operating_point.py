"""Where an experiment's loops are looked at: the robot at rest, in free air and pressing.

The small-signal frequency response of a drive, measured through its FMU.

Where FMI offers partial derivatives (fmi2GetDirectionalDerivative, fmi3GetDirectionalDerivative) a co-simulation FMU
gives those of its outputs at one instant, not of the step that the master makes with it: solver, sampled loops and
delays inside are left out, and its states cannot be listed. None of the drives of fmus/ offers them. So the step itself
is measured, which every FMU has.

On the steady command comes a periodic sum of sines with random phases, once on the command and once on the load, for
several draws of the phases: of a drive that is not quite linear their mean is the best linear approximation (Pintelon
and Schoukens 2012, System Identification, Ch. 3). It is taken at rest and with small sines, as the operating point
asks: friction that is smooth about zero speed brakes there much more than while the shaft turns. A drive whose small
signals drown in the steps of its registers, or in friction that sticks, is measured while it turns instead.

An experiment's loops at each operating point, linear and sampled as the co-simulation steps them.
"""

import copy
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import InputRefused, Unreachable
from twin.robot.assembly.build import belief, plant_parameters, shafts
from twin.robot.assembly.drives import DrivePlan, planned
from twin.robot.controller.pid import Gains, force_gains
from twin.robot.controller.program import Push, Tap
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import whole_ticks
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.plant.component import resting
from twin.robot.plant.contact import contact_force, stopped, surface_depth
from twin.robot.plant.dynamics import PlantParameters, series_share, spring_stiffness
from twin.studies.analyse.linear.hand import linear_plant
from twin.studies.analyse.linear.loops import (
    LOOPS,
    DriveModel,
    Estimation,
    Loops,
    LoopSettings,
    LoopStepping,
    estimation,
    fitted_drive,
    linear_law,
    open_loops,
    period_map,
    tick_map,
)
from twin.studies.metrics.response import Curve
from twin.studies.qualify.bench import on_bench, refuse_impossible
from twin.studies.qualify.definitions import LOAD_IN_USE, SPEED_IN_USE

CLEARANCE = 1e-3
"""Height (m) over the surface at which a pose is looked at in free air, too."""
DEEPEST = 0.1
"""Depth (m) beyond which no surface is pressed."""
SMALLEST_DEFLECTION = 2e-5
"""Least deflection (rad) of a spring with backlash: ten times the steps by which the plant is differentiated."""


@dataclass(frozen=True)
class OperatingPoint:
    """The robot at rest.

    Attributes:
        p_B: platform position (m).
        F_z: pressing force (N); 0 in free air.
        x, theta_m: state (8,) and motor angles (3,) at rest: friction sticks, with its bristle straight.
    """

    name: str
    p_B: tuple[float, float, float]
    F_z: float
    force_on: bool
    parameters: PlantParameters
    x: np.ndarray
    theta_m: np.ndarray

    @property
    def in_contact(self) -> bool:
        return self.F_z > 0.0


def operating_points(experiment: Experiment) -> tuple[list[OperatingPoint], list[str]]:
    """(points, sentences about those that have no linear model): the start, and each place that is pressed on, touching
    and 1 mm above.

    A surface that moves is taken where it is at the beginning.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    points: list[OperatingPoint] = []
    problems: list[str] = []

    def look_at(make: Callable[[], OperatingPoint]) -> None:
        try:
            points.append(make())
        except InputRefused as refusal:
            problems.append(str(refusal))

    look_at(lambda: resting_point("start", parameters, experiment.start))
    for place in _touches(experiment, parameters):
        above = (place.x, place.y, surface_height(parameters, place.x, place.y) + CLEARANCE)
        if not any(np.allclose(point.p_B, above) for point in points):
            look_at(lambda above=above: resting_point("above", parameters, above))  # type: ignore[misc]
        look_at(lambda place=place: _pressing(parameters, place))  # type: ignore[misc]
    if not points:
        raise InputRefused(problems[0])
    return points, list(dict.fromkeys(problems))


def resting_point(
    name: str, parameters: PlantParameters, p_B: tuple[float, float, float], force_on: bool = False
) -> OperatingPoint:
    """The robot at rest at `p_B` (m).

    Raises:
        InputRefused: `p_B` is out of reach, or a spring carries so little there that it hangs in its backlash.
    """
    where = "({:g}, {:g}, {:g}) mm".format(*(round(1e3 * value, 3) for value in p_B))
    try:
        x, theta_m = resting(parameters, p_B)
    except Unreachable as refusal:
        raise InputRefused(f"no operating point at {where}: {refusal}") from None
    theta_l = joint_angles(Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b), p_B)
    backlash = parameters.backlash + np.array(parameters.backlash_added)
    loaded = np.abs(theta_m - parameters.N * theta_l - np.array(parameters.slip)) - backlash
    slack = np.flatnonzero((loaded < SMALLEST_DEFLECTION) & (backlash > 0.0))
    if len(slack):
        raise InputRefused(
            f"no linear model at {where}: the spring of leg {slack[0] + 1} carries nothing there and hangs free in its "
            "backlash. Choose a point or a force a little different, or --set plant.backlash_deg=0"
        )
    return OperatingPoint(name, p_B, -_force(parameters, p_B), force_on, parameters, x, theta_m)


def surface_height(parameters: PlantParameters, x: float, y: float) -> float:
    """Height (m) of the surface at (x, y)."""

    def depth(z: float) -> float:
        return float(surface_depth(parameters, x, y, z))

    return float(brentq(depth, parameters.z_s - DEEPEST, parameters.z_s + DEEPEST, xtol=1e-12))


def pressing_height(parameters: PlantParameters, x: float, y: float, F_z: float) -> float:
    """Height (m) of the platform at which the surface answers with the vertical force `F_z` (N) at rest.

    Raises:
        InputRefused: the surface does not, down to `DEEPEST`.
    """
    top = surface_height(parameters, x, y)
    lack = F_z + _force(parameters, (x, y, top - DEEPEST))
    if not lack < 0.0:
        raise InputRefused(
            f"no operating point at ({1e3 * x:g}, {1e3 * y:g}) mm: the surface does not reach {F_z:g} N within "
            f"{1e3 * DEEPEST:g} mm of depth; press less, or raise [contact] stiffness_N_per_m"
        )
    return float(brentq(lambda z: F_z + _force(parameters, (x, y, z)), top - DEEPEST, top, xtol=1e-12))


def on_stiffness(point: OperatingPoint, K: float) -> OperatingPoint:
    """The same pose and force on a surface of stiffness `K` (N/m), which is moved up or down for it.

    Raises:
        InputRefused: it would have to be pressed in deeper than `DEEPEST`.
    """
    parameters, (x, y, z) = point.parameters._replace(K=K), point.p_B

    def excess(up: float) -> float:
        return -_force(parameters._replace(z_s=parameters.z_s + up), (x, y, z)) - point.F_z

    gap = z - surface_height(parameters, x, y)
    if not excess(gap + DEEPEST) > 0.0:
        raise InputRefused(f"a surface of {K:g} N/m does not reach {point.F_z:g} N within {1e3 * DEEPEST:g} mm")
    moved = parameters._replace(z_s=parameters.z_s + brentq(excess, gap, gap + DEEPEST, xtol=1e-12))
    return resting_point(point.name, moved, point.p_B, point.force_on)


def _force(parameters: PlantParameters, p: tuple[float, float, float]) -> float:
    """F_ee_B_z (N) at rest at `p`."""
    return float(contact_force(parameters, *p, 0.0, 0.0, 0.0, 0.0, 0.0)[2])


class PressPlace(NamedTuple):
    """A place that is pressed on: with the force F_z (N), or, if that is None, as deep as z (m) says."""

    x: float
    y: float
    z: float
    F_z: float | None
    force_on: bool


def _pressing(parameters: PlantParameters, place: PressPlace) -> OperatingPoint:
    z = place.z if place.F_z is None else pressing_height(parameters, place.x, place.y, place.F_z)
    return resting_point("pressing", parameters, (place.x, place.y, z), place.force_on)


def _touches(experiment: Experiment, parameters: PlantParameters) -> list[PressPlace]:
    """Each place that is pressed on, once. In a tap the force loop is off."""
    found: list[PressPlace] = []
    for task in experiment.tasks:
        corners = [task.point, task.to] if isinstance(task, Push) else [task.point]
        found += [PressPlace(x, y, 0.0, task.force, not isinstance(task, Tap)) for x, y in corners]
    if experiment.reference is not None:
        force_on = experiment.controller.mode == "force_position"
        F_ref = experiment.controller.force.reference if force_on else None
        for x, y, z in experiment.reference.p:
            if _force(parameters, (x, y, z)) < 0.0:
                found.append(PressPlace(x, y, 0.0 if force_on else z, F_ref, force_on))
    return list(dict.fromkeys(found))


def undisturbed(experiment: Experiment, **contact: float) -> Experiment:
    """With values of its contact, which stands still; no fault, change, monitor or display."""
    still = experiment.contact.model_copy(update={"breathing": None, "shift": None, **contact})
    return replace(experiment, contact=still, faults=(), changes=(), monitor=None, scale=None)


PERIOD = 1.0
"""Of the sum of sines (s)."""
LINES = 32
"""Sines, evenly spaced over the logarithm of the frequency as far as whole periods allow."""
HIGHEST = 0.2
"""Highest frequency over the rate of ticks."""
DRAWS = 4
SEED = 1
PROPORTIONAL = 0.05
"""Residual up to which a drive answers small signals in proportion."""


class Excitation(NamedTuple):
    """What a drive is measured with: steady command, largest added command (rad/s), largest added load (N m)."""

    steady: float
    command: float
    load: float


AT_REST = Excitation(0.0, 0.02 * SPEED_IN_USE, 0.02 * LOAD_IN_USE)
TURNING = Excitation(3.0 * SPEED_IN_USE, SPEED_IN_USE, LOAD_IN_USE)
"""Fast enough that, with the sines and under load, friction does not change sign."""

Inputs = tuple[float, float]
"""Command (rad/s) and load (N m)."""


def identified(plan: DrivePlan, tick: float, tau_load: float) -> DriveModel:
    """The linear model of a drive around a steady load `tau_load` (N m).

    The same drive gives the same model: the draws of the phases are always the same.
    """
    measured = frequency_response(plan, tick, tau_load, AT_REST)
    # whatever it refuses, the measurement of the turning shaft may still be shown
    with suppress(InputRefused):
        at_rest = fitted_drive(*measured, tick, plan.label)
        if at_rest.residual <= PROPORTIONAL:
            return at_rest
    turning = fitted_drive(*frequency_response(plan, tick, tau_load, TURNING), tick, plan.label)
    return replace(turning, turning=True)


def frequency_response(
    plan: DrivePlan, tick: float, tau_load: float, excitation: Excitation
) -> tuple[Curve, NDArray[np.complex128], Curve]:
    """(frequencies (n,) in Hz from 0, advance of the shaft per tick over command and load (n, 2), its uncertainty), SI.

    The uncertainty (n, 2) is the standard deviation of the mean over the draws.
    """
    samples = round(PERIOD / tick)
    lines = np.unique(np.round(np.geomspace(1.0, HIGHEST * samples, LINES)).astype(int))
    steady = (excitation.steady, tau_load)
    drawn = np.zeros((DRAWS, 1 + len(lines), 2), dtype=complex)
    for channel, step in enumerate((excitation.command, excitation.load)):
        drawn[:, 0, channel] = _steady_gain(plan, tick, samples, steady, channel, step)
        random = np.random.default_rng(SEED)
        for draw in range(DRAWS):
            wave = step * sum_of_sines(samples, lines, random.uniform(0.0, 2.0 * np.pi, len(lines)))
            advance = _advance(plan, tick, _played(steady, channel, np.tile(wave, 2)))[samples:]
            drawn[draw, 1:, channel] = np.fft.rfft(advance)[lines] / np.fft.rfft(wave)[lines]
    frequencies = np.concatenate([[0.0], lines / (samples * tick)])
    return frequencies, drawn.mean(axis=0), drawn.std(axis=0, ddof=1) / np.sqrt(DRAWS)


def sum_of_sines(samples: int, lines: NDArray[np.int64], phases: Curve) -> Curve:
    """One period (samples,) of sines that fit into it `lines` (n,) times, with `phases` (n,); the largest value is 1.

    Amplitudes fall with the square root of the frequency, so that high frequencies do not drive a drive to its limits.
    """
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * phases) / np.sqrt(lines)
    wave = np.fft.irfft(spectrum, samples)
    return wave / np.max(np.abs(wave))


def _steady_gain(plan: DrivePlan, tick: float, samples: int, steady: Inputs, channel: int, step: float) -> float:
    """Mean advance over the second period with the input `channel` higher by `step`, less that with it lower."""
    means = [
        np.mean(_advance(plan, tick, _played(steady, channel, np.full(2 * samples, sign * step)))[samples:])
        for sign in (1.0, -1.0)
    ]
    return float(means[0] - means[1]) / (2.0 * step)


def _played(steady: Inputs, channel: int, added: Curve) -> Curve:
    inputs = np.tile(steady, (len(added), 1))
    inputs[:, channel] += added
    return inputs


def _advance(plan: DrivePlan, tick: float, inputs: Curve) -> Curve:
    """Advance of the shaft in each tick (n,) rad for `inputs` (n, 2) of a fresh instance; of three axes the first."""
    with on_bench(plan, tick, inputs) as system:
        rows = Simulation(system, len(inputs), len(inputs) + 1).run()
        refuse_impossible(plan, system, rows)
        return np.diff(rows[:, system.columns("drive.theta_m").start])


OFF = Gains(0.0)


@dataclass(frozen=True)
class LinearPoint:
    """The loops at one operating point.

    Attributes:
        loops: all open, see `twin.studies.analyse.linear.loops.open_loops`.
        gains: 1 for each loop that is closed there.
    """

    point: OperatingPoint
    loops: Loops
    gains: dict[str, float] = field(default_factory=dict)


class Linearised:
    """What all operating points of an experiment share: drives, settings, stepping.

    Args:
        experiment: its faults are left out.
        points: the drives are identified under the mean load of these.

    Attributes:
        drives: one model per joint.
        labels: what the drives are called.
    """

    def __init__(self, experiment: Experiment, points: list[OperatingPoint]):
        self.experiment = experiment
        self.stepping = _stepping(experiment)
        load = float(np.mean([_loads(point) for point in points]))
        models: list[DriveModel] = []
        tables = experiment.drives
        plans = [planned(table) for table in tables]
        for i, table in enumerate(tables):
            same = tables.index(table)
            models.append(models[same] if same < i else identified(plans[i], experiment.cosim.tick, load))
        self.drives, self.labels = tuple(models), tuple(plan.label for plan in plans)

    def at(self, point: OperatingPoint) -> LinearPoint:
        """The loops at `point`."""
        plant = linear_plant(point.parameters, point.x, point.theta_m)
        robot = period_map(tick_map(plant, self.drives, self.stepping), self.stepping)
        settings = self.settings(point.force_on)
        law = linear_law(settings, self.estimation(point))
        return LinearPoint(point, open_loops(robot, law), dict.fromkeys(closed_in(settings), 1.0))

    def of(self, experiment: Experiment) -> Self:
        """The same for `experiment`, which has the same drives."""
        other = copy.copy(self)
        other.experiment = experiment
        return other

    def settings(self, force_on: bool) -> LoopSettings:
        """Of the controller, with its force loop on or off."""
        c = self.experiment.controller
        damping = c.damping if self.experiment.tasks else None
        return LoopSettings(
            N=c.model.N,
            eta=c.model.eta,
            position=Gains.made(c.position),
            force=force_gains(c.force) if force_on else OFF,
            corner=c.force.filter,
            damping=damping,
            period=self.stepping.period * self.stepping.tick,
        )

    def estimation(self, point: OperatingPoint) -> Estimation:
        """What the controller's estimator makes of the angles near `point`."""
        plant, parameters = self.experiment.plant, point.parameters
        geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
        angles = np.concatenate([point.theta_m, joint_angles(geometry, point.p_B)])
        motor, joint = shafts(plant)
        read = angles + np.concatenate([motor.error(angles[:3]), joint.error(angles[3:])])
        # the command with which a drive stands still under its load
        gains = np.array([drive.steady_gain for drive in self.drives])
        standing = -gains[:, 1] / gains[:, 0] * _loads(point)
        compensation = self.experiment.controller.gravity_compensation
        return estimation(belief(self.experiment), compensation, read, standing)


def closed_in(settings: LoopSettings) -> tuple[str, ...]:
    """Those of `LOOPS` that a controller with these `settings` closes."""
    return LOOPS if any(settings.force[:3]) else LOOPS[:3]


def _loads(point: OperatingPoint) -> np.ndarray:
    """tau_load (3,) at rest (N m)."""
    p = point.parameters
    geometry = Geometry(p.a, p.b, p.l_a, p.l_b)
    d = point.theta_m - p.N * joint_angles(geometry, point.p_B) - np.array(p.slip)
    loaded = np.sign(d) * np.maximum(np.abs(d) - p.backlash - np.array(p.backlash_added), 0.0)
    return np.array([spring_stiffness(p, leg) * series_share(p, leg) * stopped(p, loaded[leg]) for leg in range(3)])


def _stepping(experiment: Experiment) -> LoopStepping:
    c = experiment.controller
    period, delay = experiment.controller_ticks, c.delay_ticks
    if experiment.monitor is not None and (period % experiment.monitor_ticks or delay % experiment.monitor_ticks):
        raise InputRefused(
            f"[monitor] period_ms = {1e3 * experiment.monitor_ticks * experiment.cosim.tick:g} passes the controller's "
            "commands on late; the analysis knows only monitors that divide the controller's period and delay"
        )
    jacobi = experiment.cosim.scheme == "jacobi"
    # nothing behind the monitor and before the encoders is sampled
    latency = whole_ticks(experiment.plant.encoder_latency, experiment.cosim.tick) or 0
    late = delay + c.bus_delay_ticks + latency
    return LoopStepping(experiment.cosim.tick, experiment.plant.substeps, period, late, jacobi)
