"""Response of the platform to a nudge in the co-simulation, with gains that are raised or lowered beforehand."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.assembly.build import controller
from twin.robot.controller.controller import Controller
from twin.robot.controller.program import Phase, PhaseKind
from twin.robot.controller.task_controller import TaskController, set_hold_point
from twin.robot.experiment.experiment import Experiment, with_exact_encoders, with_plant
from twin.robot.experiment.schema import WayPoints
from twin.robot.run.shared_prefix import simulate_variants
from twin.studies.analyse.linear.loops import Matrix
from twin.studies.analyse.operating_point import OperatingPoint, undisturbed_experiment

GAIN_START, GAIN_END, NUDGE_TIME, END_TIME = 0.5, 2.5, 3.0, 6.0
"""Times (s): start and end of the gain ramp, nudge, end of the run."""
SWING_WINDOW = 1.0
"""Duration (s) over which a swing is measured: before the nudge and before the end."""
GAIN_INTERVAL = 0.02
"""Time (s) between two changes of the gains."""
MAX_DISTANCE = 0.01
"""Distance (m) from the hold point that a platform never reaches if it comes to rest after a nudge."""
HOLD_DURATION = 1e9
"""Duration (s) of a phase that never ends."""
LASTING_SHARE = 0.4
"""Share of a nudge above which its remainder counts as lasting; at the limit of a linear loop that much remains."""
SWING_RATIO = 3.0
"""Factor on the swing before the nudge below which a swing does not count, because a drive may hum all the time."""
MAX_IDLE_SWING = 1e-3
"""Largest swing (m) that counts as hum."""
GAIN_NAMES = ("kp", "ki", "kd")
NO_LIMIT = {"speed_limit": 1000.0, "dead_zone": 0.0, "tissue": None, "breath": None, "energy_tank": None}


class ResidualSwing(NamedTuple):
    """Peak-to-peak swings (m), worst direction, before and long after a nudge; infinite after divergence or failure."""

    before: float
    after: float

    def lasts(self, nudge: float) -> bool:
        """Whether the swing after a `nudge` (m) has not died out."""
        return self.after > max(LASTING_SHARE * nudge, min(SWING_RATIO * self.before, MAX_IDLE_SWING))


def residual_swings(
    experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudges: Sequence[float]
) -> list[ResidualSwing]:
    """Simulate nudges (m) with scaled gains of the law "position" or "force"; return the remaining swings."""
    tick = experiment.cosim.tick
    width, before = round(SWING_WINDOW / tick), round(NUDGE_TIME / tick)
    return [
        ResidualSwing(swing(p_B[before - width : before]), swing(p_B[-width:]))
        if len(p_B) > round(END_TIME / tick)
        else ResidualSwing(0.0, np.inf)
        for p_B in nudged_paths(experiment, point, law, factor, nudges)
    ]


def nudged_paths(
    experiment: Experiment,
    point: OperatingPoint,
    law: str,
    factor: float,
    nudges: Sequence[float],
    over: float = END_TIME,
) -> list[Matrix]:
    """Simulate nudges like `residual_swings`; return paths (n, 3), m, by tick, to `over` (s), divergence or failure."""
    still = replace(holding_experiment(experiment, point), duration_ticks=round(over / experiment.cosim.tick))

    def make() -> Assembly:
        return assemble(still, {"controller": holding_controller(still, point)} if experiment.tasks else {})

    runs = simulate_variants(
        make,
        round(NUDGE_TIME / experiment.cosim.tick),
        still.duration_ticks,
        ["plant.p_B"],
        [partial(set_hold_point, p_B=[p + nudge for p in point.p_B]) for nudge in nudges],
        lambda system: [_GainRamp(system, point, law, factor)],
        max(1, round(GAIN_INTERVAL / experiment.cosim.tick)),
    )
    # a run that goes far off in its last slice has all its rows: drop the last one so that it counts as shorter
    paths = [path["plant.p_B"] for path in runs]
    return [p_B[:-1] if len(p_B) and _is_far_off(p_B[-1], point) else p_B for p_B in paths]


def _is_far_off(p_B: Matrix, point: OperatingPoint) -> bool:
    return not np.abs(p_B - point.p_B).max() < MAX_DISTANCE


def swing(p_B: Matrix) -> float:
    """Return the peak-to-peak deviation of a path (n, 3) from its straight line, in the worst direction."""
    t = np.arange(len(p_B), dtype=float)
    return float(max(np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)) for p in p_B.T))


def holding_experiment(experiment: Experiment, point: OperatingPoint) -> Experiment:
    """Return the experiment with the robot held at an operating point, without other motion or faults."""
    c = experiment.controller
    force = {"reference": point.F_z, "trigger": None, "trigger_time": 0.0, "limit": 1.0}
    mode = "force_position" if point.force_on else "position"
    computer = c.model_copy(update={**NO_LIMIT, "mode": mode, "force": c.force.model_copy(update=force)})
    alone = replace(
        undisturbed_experiment(experiment),
        reference=WayPoints((0.0, NUDGE_TIME - c.period, NUDGE_TIME), (point.p_B,) * 3),
        controller=computer,
        duration_ticks=round(END_TIME / experiment.cosim.tick),
    )
    return with_exact_encoders(with_plant(alone, backlash=0.0))


class _GainRamp(Observer):
    """Observer that ramps a law's gains, low ones from the start as high ones may shake; it stops diverging runs."""

    def __init__(self, system: System, point: OperatingPoint, law: str, factor: float):
        self._tick, self._factor, self._p_B, self._point = system.tick, factor, system.columns("plant.p_B"), point
        memory = system.component("controller").memory  # type: ignore[attr-defined]
        self._gains = [(memory[law][name], memory[law][name].copy()) for name in GAIN_NAMES]

    def begin(self, simulation: Simulation) -> None:
        self.enough = False

    def ready(self, tick: int) -> None:
        t = tick * self._tick
        share = min(max((t - GAIN_START) / (GAIN_END - GAIN_START), 0.0), 1.0)
        for gain, as_set in self._gains:
            gain[...] = (self._factor**share if self._factor > 1.0 else self._factor) * as_set

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.enough = len(rows) > 0 and _is_far_off(rows[-1, self._p_B], self._point)


def holding_controller(experiment: Experiment, point: OperatingPoint) -> Controller | TaskController:
    """Return the experiment's controller, including its laws for tasks, with one endless phase that holds a point."""
    hold = Phase(PhaseKind.HOLD, 1, force_on=point.force_on, F_end=point.F_z, duration=HOLD_DURATION)
    found = controller(experiment, [hold])
    # initialise the force as if the robot had been pressing
    found.memory["F_z"], found.memory["machine"]["F_ref"] = point.F_z, point.F_z
    return found
