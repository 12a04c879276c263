"""Step halving: every coupling at several ticks against one reference, without quantisation to ticks or counts.

An error in the time of an event is of order one in the tick for any coupling; an encoder's count is as large as many a
coupling error; and a trigger decided by a count shifts by whole periods.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment, shorten, with_exact_encoders, with_plant
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.run.trace import run_in_memory
from twin.studies.command import Say, Steps, ignore_progress
from twin.studies.converge.power import PowerResidual, power_residuals
from twin.studies.converge.reference import COUPLINGS, Coupling, ReferenceRun, reference_of
from twin.studies.converge.signals import (
    COMPARED_SIGNALS,
    FORCE_SIGNAL,
    POSITION_SIGNAL,
    Signal,
    largest_errors,
    sampled_run,
)

TICK_SHARES = (2.0, 1.0, 0.5, 0.25, 0.125)
"""Ticks to run, in ticks of the experiment; those incompatible with periods or drives are left out."""
MAX_SLOPE_SPREAD = 0.3
"""Maximum spread of the slopes of neighbouring pairs for a power law."""
MIN_ERRORS = 3
"""Minimum number of errors above the floor for a slope that can be checked."""
MIN_SLOPE = 0.5
"""Minimum slope of an order: a smaller one is not due to the coupling."""
OUT_OF_REACH = 1e9
"""A trigger force (N) that is never reached."""


class OrderFinding(StrEnum):
    """Reliability of an observed order of convergence."""

    SMOOTH = "smooth"
    NOT_SMOOTH = "not smooth"
    NOT_FALLING = "does not fall with the tick"
    AT_FLOOR = "at the reference's own accuracy"
    UNSTABLE = "not stable at every tick"


@dataclass(frozen=True)
class Order:
    """Observed order of convergence p in error = C tick^p; if meaningless, `slope` is None, `finding` the reason."""

    slope: float | None
    finding: OrderFinding


def observed_order(ticks: ArrayLike, errors: ArrayLike, floor: float) -> Order:
    """Fit the order of convergence by least squares in log-log over the errors that the coupling causes.

    Args:
        ticks: s, (n,).
        errors: >= 0, infinite for a failed run, (n,).
        floor: accuracy of the reference; errors up to ten times this are left out.
    """
    h, e = np.asarray(ticks, dtype=float), np.asarray(errors, dtype=float)
    if not np.all(np.isfinite(e)):
        return Order(None, OrderFinding.UNSTABLE)
    clear = e > 10.0 * floor
    if np.count_nonzero(clear) < MIN_ERRORS:
        return Order(None, OrderFinding.AT_FLOOR)
    by_tick = np.argsort(h[clear])
    log_h, log_e = np.log(h[clear][by_tick]), np.log(e[clear][by_tick])
    pairs = np.diff(log_e) / np.diff(log_h)
    slope = float(np.polyfit(log_h, log_e, 1)[0])
    if slope < MIN_SLOPE:
        return Order(None, OrderFinding.NOT_FALLING)
    return Order(slope, OrderFinding.NOT_SMOOTH if np.ptp(pairs) > MAX_SLOPE_SPREAD else OrderFinding.SMOOTH)


def comparable_experiment(experiment: Experiment) -> tuple[Experiment, tuple[str, ...]]:
    """Return the experiment with exact encoders and a force loop triggered by time, and a phrase for each change."""
    if experiment.faults:
        raise InputRefused(f"{experiment.name}: has faults, whose effect is not a coupling error; remove [[fault]]")
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
    smooth = with_exact_encoders(experiment)
    refuse_third_party_parts(experiment, "a study of the coupling", ("controller", "estimator"))
    if experiment.monitor is not None:
        # the monitor assumes the robot's real encoders
        smooth = replace(smooth, monitor=None)
        changes.append("no safety monitor")
    triggered = np.flatnonzero(run_in_memory(experiment, only=["controller.triggered"]).held("controller.triggered"))
    if len(triggered) and experiment.controller.force.trigger is not None:
        when = float(triggered[0] * experiment.cosim.tick)
        force = experiment.controller.force.model_copy(update={"trigger": OUT_OF_REACH, "trigger_time": when})
        smooth = replace(smooth, controller=smooth.controller.model_copy(update={"force": force}))
        changes.append(f"force loop on at {when:g} s, not by force")
    return smooth, tuple(changes)


def without_friction(experiment: Experiment) -> Experiment:
    """Remove backlash and friction from an experiment, so that its motion has no events."""
    contact = experiment.contact.model_copy(update={"friction": 0.0})
    return replace(with_plant(experiment, backlash=0.0, joint_friction=0.0), contact=contact)


@dataclass(frozen=True)
class TickPoint:
    """One run: tick (s), largest error of each signal (SI, infinite if it failed), wall time per simulated time."""

    tick: float
    errors: dict[str, float]
    cost: float

    JSON_KEYS = "tick_s=tick cost_s_per_s=cost largest_error=errors"


@dataclass(frozen=True)
class CouplingSeries:
    """The runs of one coupling of drives and plant, from the longest tick to the shortest.

    Attributes:
        residuals: power residuals of the three joints at the experiment's own tick; empty if that run failed.
    """

    coupling: Coupling
    points: tuple[TickPoint, ...]
    orders: dict[str, Order]
    residuals: tuple[PowerResidual, ...]

    JSON_KEYS = "coupling points order=orders power=residuals"


@dataclass(frozen=True)
class CouplingChoice:
    """The recommended coupling and tick, which keep the force within the tolerance."""

    coupling: Coupling
    point: TickPoint

    JSON_KEYS = "coupling tick_s=point.tick error_N=point.errors.F_z"


@dataclass(frozen=True)
class CouplingStudy:
    """Result of a coupling study: errors of each coupling over the tick, and the recommended one.

    Attributes:
        duration, tick: simulated duration and tick (s).
        left_out: name of a coupling -> reason.
        tolerance: tolerance of the force (N).
        choice: None if no run is within the tolerance, or if the robot never presses.
        resolution: step of the scale's display (N); None without a scale.
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
    def judged_signal(self) -> Signal:
        """The decisive signal of a coupling study: the force, or the position if the robot never presses."""
        return FORCE_SIGNAL if self.reference.is_pressing else POSITION_SIGNAL


def convergence(
    experiment: Experiment,
    tolerance: float = 0.005,
    duration: float | None = None,
    smooth: bool = False,
    say: Say = ignore_progress,
) -> CouplingStudy:
    """Run an experiment with every coupling at every tick, and recommend one within the tolerance.

    Args:
        tolerance: tolerance of the pressing force (N).
        duration: duration of each run (s); None for the whole experiment.
        smooth: whether to remove backlash and friction as well.
    """
    steps = Steps(say, 1 + len(COUPLINGS))
    steps.next("reference")
    used, changes = comparable_experiment(experiment)
    if duration:
        used = shorten(used, duration)
    if smooth:
        used, changes = without_friction(used), (*changes, "no backlash", "no friction under the head")
    reference = reference_of(used)
    series: list[CouplingSeries] = []
    left_out: dict[str, str] = {}
    for coupling in COUPLINGS:
        steps.next(coupling.name)
        try:
            series.append(_series(used, coupling, reference))
        except InputRefused as why:
            # the first coupling is never refused by itself: the refusal concerns the experiment
            if coupling == COUPLINGS[0]:
                raise
            left_out[coupling.name] = str(why)
    cosim = experiment.cosim
    return CouplingStudy(
        name=experiment.name,
        duration=used.duration_ticks * cosim.tick,
        tick=cosim.tick,
        coupling=Coupling(cosim.scheme, cosim.inputs, cosim.iterations),
        changes=changes,
        reference=reference,
        series=tuple(series),
        left_out=left_out,
        tolerance=tolerance,
        choice=recommend_coupling(series, tolerance) if reference.is_pressing else None,
        resolution=experiment.scale.resolution * G_ACCELERATION if experiment.scale else None,
    )


def recommend_coupling(series: list[CouplingSeries], tolerance: float) -> CouplingChoice | None:
    """Find the longest tick that keeps the force within the tolerance, and the simplest coupling that does.

    Every shorter tick must comply, too: an error that is small at one tick only is a coincidence. Couplings are in the
    order of their simplicity, which is also the order of their cost; unlike measured times, it is the same on every
    machine.
    """
    ticks = sorted({point.tick for one in series for point in one.points}, reverse=True)
    for tick in ticks:
        for one in series:
            for point in one.points:
                shorter = [other for other in one.points if other.tick <= tick]
                if point.tick == tick and all(other.errors[FORCE_SIGNAL.name] <= tolerance for other in shorter):
                    return CouplingChoice(one.coupling, point)
    return None


def _series(experiment: Experiment, coupling: Coupling, reference: ReferenceRun) -> CouplingSeries:
    points = tuple(_points(experiment, coupling, reference))
    ticks = [point.tick for point in points]
    orders = {
        signal.name: observed_order(
            ticks, [point.errors[signal.name] for point in points], reference.floor[signal.name]
        )
        for signal in COMPARED_SIGNALS
    }
    own = coupling.apply_to(experiment, experiment.cosim.tick)
    ran = any(point.tick == own.cosim.tick and np.isfinite(point.cost) for point in points)
    return CouplingSeries(coupling, points, orders, power_residuals(own) if ran else ())


def _points(experiment: Experiment, coupling: Coupling, reference: ReferenceRun) -> Iterator[TickPoint]:
    for share in TICK_SHARES:
        try:
            varied = coupling.apply_to(experiment, share * experiment.cosim.tick)
            samples, cost = sampled_run(varied)
        except InputRefused:
            # at the experiment's own tick the coupling itself is incompatible, not the tick
            if share == 1.0:
                raise
            continue
        except ComponentFailed:
            yield TickPoint(share * experiment.cosim.tick, {signal.name: np.inf for signal in COMPARED_SIGNALS}, np.inf)
            continue
        yield TickPoint(varied.cosim.tick, largest_errors(samples, reference.samples), cost)
