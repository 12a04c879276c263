"""What a nudge of the platform leaves in the co-simulation, with gains that are raised or lowered on the way."""

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
"""Times (s): the gains begin to change, have changed; the nudge; the end."""
SWING_WINDOW = 1.0
"""How long (s) a swing is looked at: before the nudge and before the end."""
GAIN_INTERVAL = 0.02
"""Time (s) between two changes of the gains."""
MAX_DISTANCE = 0.01
"""Distance (m) from where it is held at which no nudge leads a platform that comes to rest."""
HOLD_DURATION = 1e9
"""s. A phase that long does not end."""
LASTING_SHARE = 0.4
"""Share of a nudge that is left in the end from which on it lasts: at the limit of a linear loop that much is."""
SWING_RATIO = 3.0
"""Times the swing before the nudge that a swing is compared with: a drive may hum all the time."""
MAX_IDLE_SWING = 1e-3
"""m. A larger swing is no hum."""
GAIN_NAMES = ("kp", "ki", "kd")
NO_LIMIT = {"speed_limit": 1000.0, "dead_zone": 0.0, "tissue": None, "breath": None, "energy_tank": None}


class ResidualSwing(NamedTuple):
    """Swings of the platform, peak to peak about a straight line in the worst direction (m).

    Attributes:
        hum: before the nudge.
        left: in the end; infinite if the platform went far off, or a component failed.
    """

    before: float
    after: float

    def lasts(self, nudge: float) -> bool:
        """Whether a `nudge` (m) did not die out."""
        return self.after > max(LASTING_SHARE * nudge, min(SWING_RATIO * self.before, MAX_IDLE_SWING))


def residual_swings(
    experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudges: Sequence[float]
) -> list[ResidualSwing]:
    """What each of `nudges` (m) at `point` leaves with `factor` times the gains of `law`, "position" or "force"."""
    tick, found = experiment.cosim.tick, []
    width, before = round(SWING_WINDOW / tick), round(NUDGE_TIME / tick)
    for p_B in nudged_paths(experiment, point, law, factor, nudges):
        gone = len(p_B) <= round(END_TIME / tick)
        found.append(
            ResidualSwing(0.0, np.inf)
            if gone
            else ResidualSwing(swing(p_B[before - width : before]), swing(p_B[-width:]))
        )
    return found


def nudged_paths(
    experiment: Experiment,
    point: OperatingPoint,
    law: str,
    factor: float,
    nudges: Sequence[float],
    over: float = END_TIME,
) -> list[Matrix]:
    """The platform's ways (n, 3) in m, tick by tick until `over` (s); shorter if it went far off or a component failed.

    Args: as of `residual_swings`.
    """
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
    # what ends in the slice in which it goes far off has been seen to its end, too
    paths = [path["plant.p_B"] for _, path in runs]
    return [p_B[:-1] if len(p_B) and _is_far_off(p_B[-1], point) else p_B for p_B in paths]


def _is_far_off(p_B: Matrix, point: OperatingPoint) -> bool:
    return not np.abs(p_B - point.p_B).max() < MAX_DISTANCE


def swing(p_B: Matrix) -> float:
    """Peak to peak of a path (n, 3), each direction about its straight line, the largest of the three."""
    t = np.arange(len(p_B), dtype=float)
    return float(max(np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)) for p in p_B.T))


def holding_experiment(experiment: Experiment, point: OperatingPoint) -> Experiment:
    """Held at `point` by way points, which tasks do not heed; nothing else moves or breaks."""
    period = experiment.controller.period
    c = experiment.controller
    force = {"reference": point.F_z, "trigger": None, "trigger_time": 0.0, "limit": 1.0}
    mode = "force_position" if point.force_on else "position"
    computer = c.model_copy(update={**NO_LIMIT, "mode": mode, "force": c.force.model_copy(update=force)})
    alone = replace(
        undisturbed_experiment(experiment),
        reference=WayPoints((0.0, NUDGE_TIME - period, NUDGE_TIME), (point.p_B,) * 3),
        controller=computer,
        duration_ticks=round(END_TIME / experiment.cosim.tick),
    )
    return with_exact_encoders(with_plant(alone, backlash=0.0))


class _GainRamp(Observer):
    """Lets gains go evenly, in their logarithm, to `factor` times theirs; has seen enough once the platform is far off.

    Gains that are lowered are low from the beginning: with the higher ones the robot may shake.
    """

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
    """That of tasks, with all that acts only in them, which for ever does one thing: hold `point`."""
    hold = Phase(PhaseKind.HOLD, 1, force_on=point.force_on, F_end=point.F_z, duration=HOLD_DURATION)
    found = controller(experiment, [hold])
    # as if it had pressed before
    found.memory["F_z"], found.memory["machine"]["F_ref"] = point.F_z, point.F_z
    return found
