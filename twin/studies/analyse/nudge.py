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
from twin.robot.controller.task_controller import TaskController, hold_at
from twin.robot.experiment.experiment import Experiment, exactly_measured, with_plant
from twin.robot.experiment.schema import WayPoints
from twin.robot.run.past import forked
from twin.studies.analyse.linear.loops import Matrix
from twin.studies.analyse.operating_point import OperatingPoint, undisturbed

SETTLED, RAISED, NUDGED, OVER = 0.5, 2.5, 3.0, 6.0
"""Times (s): the gains begin to change, have changed; the nudge; the end."""
WINDOW = 1.0
"""How long (s) a swing is looked at: before the nudge and before the end."""
SLICE = 0.02
"""Time (s) between two changes of the gains."""
FAR = 0.01
"""Distance (m) from where it is held at which no nudge leads a platform that comes to rest."""
HOLDING = 1e9
"""s. A phase that long does not end."""
LEFT = 0.4
"""Share of a nudge that is left in the end from which on it lasts: at the limit of a linear loop that much is."""
HUM = 3.0
"""Times the swing before the nudge that a swing is compared with: a drive may hum all the time."""
LOUDEST = 1e-3
"""m. A larger swing is no hum."""
GAINS = ("kp", "ki", "kd")
NO_LIMIT = {"speed_limit": 1000.0, "dead_zone": 0.0, "tissue": None, "breath": None, "energy_tank": None}


class Aftermath(NamedTuple):
    """Swings of the platform, peak to peak about a straight line in the worst direction (m).

    Attributes:
        hum: before the nudge.
        left: in the end; infinite if the platform went far off, or a component failed.
    """

    hum: float
    left: float

    def lasts(self, nudge: float) -> bool:
        """Whether a `nudge` (m) did not die out."""
        return self.left > max(LEFT * nudge, min(HUM * self.hum, LOUDEST))


def aftermaths(
    experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudges: Sequence[float]
) -> list[Aftermath]:
    """What each of `nudges` (m) at `point` leaves with `factor` times the gains of `law`, "position" or "force"."""
    tick, found = experiment.cosim.tick, []
    width, before = round(WINDOW / tick), round(NUDGED / tick)
    for p_B in nudged_paths(experiment, point, law, factor, nudges):
        gone = len(p_B) <= round(OVER / tick)
        found.append(
            Aftermath(0.0, np.inf) if gone else Aftermath(swing(p_B[before - width : before]), swing(p_B[-width:]))
        )
    return found


def nudged_paths(
    experiment: Experiment,
    point: OperatingPoint,
    law: str,
    factor: float,
    nudges: Sequence[float],
    over: float = OVER,
) -> list[Matrix]:
    """The platform's ways (n, 3) in m, tick by tick until `over` (s); shorter if it went far off or a component failed.

    Args: as of `aftermaths`.
    """
    still = replace(held(experiment, point), duration_ticks=round(over / experiment.cosim.tick))

    def make() -> Assembly:
        return assemble(still, {"controller": holding_controller(still, point)} if experiment.tasks else {})

    runs = forked(
        make,
        round(NUDGED / experiment.cosim.tick),
        still.duration_ticks,
        ["plant.p_B"],
        [partial(hold_at, p_B=[p + nudge for p in point.p_B]) for nudge in nudges],
        lambda system: [_Raising(system, point, law, factor)],
        max(1, round(SLICE / experiment.cosim.tick)),
    )
    # what ends in the slice in which it goes far off has been seen to its end, too
    paths = [path["plant.p_B"] for _, path in runs]
    return [p_B[:-1] if len(p_B) and _far_off(p_B[-1], point) else p_B for p_B in paths]


def _far_off(p_B: Matrix, point: OperatingPoint) -> bool:
    return not np.abs(p_B - point.p_B).max() < FAR


def swing(p_B: Matrix) -> float:
    """Peak to peak of a path (n, 3), each direction about its straight line, the largest of the three."""
    t = np.arange(len(p_B), dtype=float)
    return float(max(np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)) for p in p_B.T))


def held(experiment: Experiment, point: OperatingPoint) -> Experiment:
    """Held at `point` by way points, which tasks do not heed; nothing else moves or breaks."""
    period = experiment.controller.period
    c = experiment.controller
    force = {"reference": point.F_z, "trigger": None, "trigger_time": 0.0, "limit": 1.0}
    mode = "force_position" if point.force_on else "position"
    computer = c.model_copy(update={**NO_LIMIT, "mode": mode, "force": c.force.model_copy(update=force)})
    alone = replace(
        undisturbed(experiment),
        reference=WayPoints((0.0, NUDGED - period, NUDGED), (point.p_B,) * 3),
        controller=computer,
        duration_ticks=round(OVER / experiment.cosim.tick),
    )
    return exactly_measured(with_plant(alone, backlash=0.0))


class _Raising(Observer):
    """Lets gains go evenly, in their logarithm, to `factor` times theirs; has seen enough once the platform is far off.

    Gains that are lowered are low from the beginning: with the higher ones the robot may shake.
    """

    def __init__(self, system: System, point: OperatingPoint, law: str, factor: float):
        self._tick, self._factor, self._p_B, self._point = system.tick, factor, system.columns("plant.p_B"), point
        memory = system.component("controller").memory  # type: ignore[attr-defined]
        self._gains = [(memory[law][name], memory[law][name].copy()) for name in GAINS]

    def begin(self, simulation: Simulation) -> None:
        self.enough = False

    def ready(self, tick: int) -> None:
        t = tick * self._tick
        share = min(max((t - SETTLED) / (RAISED - SETTLED), 0.0), 1.0)
        for gain, as_set in self._gains:
            gain[...] = (self._factor**share if self._factor > 1.0 else self._factor) * as_set

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.enough = len(rows) > 0 and _far_off(rows[-1, self._p_B], self._point)


def holding_controller(experiment: Experiment, point: OperatingPoint) -> Controller | TaskController:
    """That of tasks, with all that acts only in them, which for ever does one thing: hold `point`."""
    hold = Phase(PhaseKind.HOLD, 1, force_on=point.force_on, F_end=point.F_z, duration=HOLDING)
    found = controller(experiment, [hold])
    # as if it had pressed before
    found.memory["F_z"], found.memory["machine"]["F_ref"] = point.F_z, point.F_z
    return found
