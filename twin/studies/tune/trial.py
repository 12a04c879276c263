"""Gains in the co-simulation with the real drives: a step at a corner, and the experiment itself."""

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.cosim.system import MemoryChange
from twin.errors import ComponentFailed
from twin.experiment.experiment import Experiment
from twin.experiment.reference import WayPoints
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.declared import PLACES
from twin.runs.assembly.tunable import FORCE_REFERENCE
from twin.runs.loop import simulate
from twin.runs.outcome import RunOutcome, Tally
from twin.runs.trace import Trace
from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.tune.corner import Corner, at_stiffness
from twin.studies.tune.gains import LawGains, with_gains
from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import HALF_POWER, HORIZON, SETTLED, Prediction, StepAnswer, answer, step_response

REST = 3.0
"""Time (s) before the step, in which the platform sags under the drives' droop."""
FORCE_STEP = 0.4
"""Step of the force, as a share of the force at the corner: well above what counts and backlash make of it (0.05 N)."""
HEIGHT_STEP = 1e-3
"""Step of z (m), upwards."""
ENDING = 0.25
"""Share of the samples after the step in which a swing that lasts is looked for."""
SPECTRUM = 2**18
"""Samples to which the step is continued before its spectrum is taken: frequencies 0.01 Hz apart."""

DOUBT = 0.05
"""Share of a step by which a simulated overshoot may exceed its goal: backlash and counts are not linear."""
SWING = 0.1
"""Peak to peak (share of the step) from which a simulated swing that lasts is told."""
SLOWER = 0.1
"""Share of the bandwidth asked for that the simulated one may lack."""


@dataclass(frozen=True)
class StepTrial:
    """A step at a corner, simulated.

    Attributes:
        corner: where.
        law: whose reference was stepped.
        t, share: s (n,) since the step, and what came of it (n,), 1 where the linear model ends.
        answer: its bandwidth is NaN if the step is not over in `HORIZON`.
        swing: of the run with the step, in the end: peak to peak about a straight line (share of the step).
    """

    corner: Corner
    law: str
    t: Matrix
    share: Matrix
    answer: StepAnswer
    swing: float


def can_be_tried(corner: Corner) -> bool:
    """Whether a step can be simulated: the position law's in air, the force law's pressing.

    Where [controller.damping] acts there is none: only tasks have it, and tasks make no steps.
    """
    damping = corner.experiment.controller.damping if corner.experiment.tasks else None
    return corner.point.in_contact == corner.point.force_on and (damping is None or damping.gain == 0.0)


def step_trial(corner: Corner, gains: LawGains) -> StepTrial | None:
    """Simulate the answer of the true force or height to a step of its reference; None if the run failed.

    The same run without the step is taken off, so that what both do falls out: the sagging before all.

    Args:
        gains: with which the linear model is stable.
    """
    try:
        moved, still = (_run(corner, gains, stepped) for stepped in (True, False))
    except ComponentFailed:
        return None
    i = 3 if corner.point.force_on else 2
    size = FORCE_STEP * corner.point.F_z if corner.point.force_on else HEIGHT_STEP
    end = size * step_response(corner, gains, i)[2]
    share = (moved - still) / end
    tick = corner.experiment.cosim.tick
    t = tick * np.arange(len(share), dtype=np.float64)
    found = answer(t, share, step_bandwidth(share, tick))
    if math.isinf(found.settling):
        found = replace(found, bandwidth=math.nan)
    return StepTrial(corner, corner.laws[0], t, share, found, lasting_swing(t, moved / end))


def step_bandwidth(share: Matrix, tick: float) -> float:
    """Where the frequency response, the spectrum of the impulse response, first falls below 1/sqrt(2) (rad/s).

    Args:
        share: answer to a unit step (n,), 1 at its end.
        tick: between its samples (s).
    """
    spectrum = np.abs(np.fft.rfft(np.diff(share, prepend=0.0), SPECTRUM))
    return float(np.argmax(spectrum < HALF_POWER) * 2.0 * np.pi / (SPECTRUM * tick))


def lasting_swing(t: Matrix, y: Matrix) -> float:
    """Peak to peak of the last `ENDING` of `y` (n,) about a straight line, which is what is left of creeping."""
    last = slice(-round(ENDING * len(y)), None)
    return float(np.ptp(y[last] - np.polyval(np.polyfit(t[last], y[last], 1), t[last])))


def _run(corner: Corner, gains: LawGains, stepped: bool) -> Matrix:
    """The true pressing force (N) or height (m) at each tick from the step on (n,)."""
    experiment, point = with_gains(at_stiffness(corner), gains), corner.point
    x, y, z = point.p_B
    period = experiment.controller.period
    up = z + (HEIGHT_STEP if stepped and not point.force_on else 0.0)
    # the last call of the controller before REST still has the old reference
    reference = WayPoints((0.0, REST - period, REST), (point.p_B, point.p_B, (x, y, up)))
    low, high = (1.0 - 0.5 * FORCE_STEP) * point.F_z, (1.0 + 0.5 * FORCE_STEP) * point.F_z
    c = experiment.controller
    force = c.force.model_copy(update={"reference": low, "trigger": None, "trigger_time": 0.0})
    mode = "force_position" if point.force_on else "position"
    held = replace(
        experiment,
        tasks=(),
        approach=None,
        reference=reference,
        controller=c.model_copy(update={"mode": mode, "force": force, "tissue": None, "breath": None}),
    )
    rest, over = (round(time / experiment.cosim.tick) for time in (REST, HORIZON))
    pressed, risen = "plant.F_ee_B", "plant.p_B"
    run = Trace(only=(pressed, risen))
    with assemble(held) as assembly:
        system = assembly.system
        if stepped and point.force_on:
            memory = PLACES[FORCE_REFERENCE].memory_of(system.component("controller"))
            assert memory is not None
            system.changes = (*system.changes, MemoryChange(rest, memory, high))
        simulate(assembly, rest + over, [run]).completed()
    return -run[pressed][rest:, 2] if point.force_on else run[risen][rest:, 2]


def contradiction(trial: StepTrial, prediction: Prediction, goals: Goals) -> str:
    """What the co-simulation does that the linear model does not and that the goals forbid; "" if nothing."""
    simulated, linear = trial.answer, prediction.answers[trial.law]
    if trial.swing > SWING:
        return f"the co-simulation never comes to rest, it swings by {100.0 * trial.swing:.0f} % of the step"
    if simulated.overshoot > goals.overshoot + DOUBT:
        return f"the co-simulation overshoots by {100.0 * simulated.overshoot:.0f} %"
    if math.isinf(simulated.settling) and math.isfinite(linear.settling):
        within = f"within {100.0 * SETTLED:g} % of its end"
        return f"the co-simulation is not {within} after {HORIZON:g} s; predicted are {linear.settling:.2g} s"
    if goals.bandwidth and trial.law == goals.law:
        # a goal that is predicted to be missed is told as such
        expected = min(goals.bandwidth, linear.bandwidth)
        if simulated.bandwidth < (1.0 - SLOWER) * expected:
            return f"the co-simulation has a bandwidth of {simulated.bandwidth / (2.0 * math.pi):.3g} Hz only"
    return ""


@dataclass(frozen=True)
class Whole:
    """The experiment itself.

    Attributes:
        drive: what its drive is called.
        outcome: None if it failed.
        trip: why the safety monitor tripped, or "".
    """

    drive: str
    outcome: RunOutcome | None
    trip: str


def whole_run(experiment: Experiment, drive: str, gains: LawGains) -> Whole:
    """Simulate `experiment` from beginning to end with `gains`; nothing is recorded."""
    tried = with_gains(experiment, gains)
    with assemble(tried) as assembly:
        tally = Tally(assembly.system)
        done = simulate(assembly, tried.duration_ticks, [tally])
    return Whole(drive, None if done.failure else tally.outcome, done.trip)
