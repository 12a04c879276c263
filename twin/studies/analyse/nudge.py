"""A nudge in the co-simulation: what is left of it tells whether the loops come to rest, with the drive as it is.

The robot rests at an operating point with the gains of the experiment; those of one law are then brought to a factor of
theirs, slowly, so that no start excites a swing; then the reference steps by the nudge in x, y and z. As in the linear
model encoders are exact, springs have no backlash, and the controller limits neither speed nor shift; the drives keep
all they have: friction, registers, sampling, limits.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent, simulate
from twin.kernel.cosim.system import System
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.computer import controller
from twin.robot.controller.controller import Controller
from twin.robot.controller.program import Phase, PhaseKind
from twin.robot.controller.task_controller import TaskController
from twin.robot.experiment.experiment import Experiment, exactly_measured, with_plant
from twin.robot.experiment.task import WayPoints
from twin.robot.run.trace import Trace
from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.operating_point import OperatingPoint

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


def aftermath(experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudge: float) -> Aftermath:
    """What a `nudge` (m) at `point` leaves with `factor` times the gains of `law`, "position" or "force".

    Raises:
        InputRefused: a drive FMU does not fit.
    """
    p_B, tick = nudged_path(experiment, point, law, factor, nudge), experiment.cosim.tick
    width, before = round(WINDOW / tick), round(NUDGED / tick)
    if len(p_B) <= round(OVER / tick):
        return Aftermath(0.0, np.inf)
    return Aftermath(swing(p_B[before - width : before]), swing(p_B[-width:]))


def nudged_path(
    experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudge: float, over: float = OVER
) -> Matrix:
    """The platform's way (n, 3) in m, tick by tick until `over` (s); shorter if it went far off or a component failed.

    Args: as of `aftermath`.
    """
    nudged = replace(held(experiment, point, nudge), duration_ticks=round(over / experiment.cosim.tick))
    substitutes = {"controller": holding_controller(nudged, point)} if experiment.tasks else {}
    with assemble(nudged, substitutes) as assembly:
        system = assembly.system
        path, raising = Trace(only=["plant.p_B"]), _Raising(system, point, law, factor, nudge)
        simulate(assembly, nudged.duration_ticks, [raising, path], max(1, round(SLICE / system.tick)))
    # what ends in the slice in which it goes far off has been seen to its end, too
    return path["plant.p_B"][: -1 if raising.enough else None]


def swing(p_B: Matrix) -> float:
    """Peak to peak of a path (n, 3), each direction about its straight line, the largest of the three."""
    t = np.arange(len(p_B), dtype=float)
    return float(max(np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)) for p in p_B.T))


def undisturbed(experiment: Experiment, **contact: float) -> Experiment:
    """With values of its contact, which stands still; no fault, change, monitor or display."""
    still = experiment.contact.model_copy(update={"breathing": None, "shift": None, **contact})
    return replace(experiment, contact=still, faults=(), changes=(), monitor=None, scale=None)


def held(experiment: Experiment, point: OperatingPoint, nudge: float) -> Experiment:
    """Held at `point` and nudged once, by way points, which tasks do not heed; nothing else moves or breaks."""
    x, y, z = point.p_B
    period = experiment.controller.period
    nudged = (x + nudge, y + nudge, z + nudge)
    c = experiment.controller
    force = {"reference": point.F_z, "trigger": None, "trigger_time": 0.0, "limit": 1.0}
    mode = "force_position" if point.force_on else "position"
    computer = c.model_copy(update={**NO_LIMIT, "mode": mode, "force": c.force.model_copy(update=force)})
    alone = replace(
        undisturbed(experiment),
        reference=WayPoints((0.0, NUDGED - period, NUDGED), (point.p_B, point.p_B, nudged)),
        controller=computer,
        duration_ticks=round(OVER / experiment.cosim.tick),
    )
    return exactly_measured(with_plant(alone, backlash=0.0))


class _Raising(Observer):
    """Lets gains go evenly, in their logarithm, to `factor` times theirs; has seen enough once the platform is far off.

    Gains that are lowered are low from the beginning: with the higher ones the robot may shake.
    """

    def __init__(self, system: System, point: OperatingPoint, law: str, factor: float, nudge: float):
        self._tick, self._factor, self._p_B = system.tick, factor, system.columns("plant.p_B")
        self._point_B, self._nudged_B = point.p_B, np.add(point.p_B, nudge)
        memory = system.component("controller").memory  # type: ignore[attr-defined]
        self._gains = [(memory[law][name], memory[law][name].copy()) for name in GAINS]
        # of tasks: way points are nudged by their reference
        self._machine = memory["machine"] if "machine" in (memory.dtype.names or ()) else None

    def ready(self, tick: int) -> None:
        t = tick * self._tick
        if self._machine is not None and t >= NUDGED:
            self._machine["start"] = self._machine["end"] = self._nudged_B
        share = min(max((t - SETTLED) / (RAISED - SETTLED), 0.0), 1.0)
        for gain, as_set in self._gains:
            gain[...] = (self._factor**share if self._factor > 1.0 else self._factor) * as_set

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.enough = len(rows) > 0 and not np.abs(rows[-1, self._p_B] - self._point_B).max() < FAR


def holding_controller(experiment: Experiment, point: OperatingPoint) -> Controller | TaskController:
    """That of tasks, with all that acts only in them, which for ever does one thing: hold `point`."""
    hold = Phase(PhaseKind.HOLD, 1, force_on=point.force_on, F_end=point.F_z, duration=HOLDING)
    found = controller(experiment, [hold])
    # as if it had pressed before
    found.memory["F_z"], found.memory["machine"]["F_ref"] = point.F_z, point.F_z
    return found
