"""A nudge in the co-simulation: what is left of it tells whether the loops come to rest, with the drive as it is.

The robot rests at an operating point with the gains of the experiment; those of one law are then brought to a factor of
theirs, slowly, so that no start excites a swing; then the reference steps by the nudge in x, y and z. As in the linear
model encoders are exact, springs have no backlash, and the controller limits neither speed nor shift; the drives keep
all they have: friction, registers, sampling, limits.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twin.analysis.drive_model import Matrix
from twin.assembly.robot import assemble
from twin.cosim.simulation import Simulation
from twin.experiment.experiment import Experiment
from twin.experiment.reference import WayPoints
from twin.experiment.variation import exactly_measured, with_plant
from twin.loop_analysis.operating_point import OperatingPoint

SETTLED, RAISED, NUDGED, OVER = 0.5, 2.5, 3.0, 6.0
"""Times (s): the gains begin to change, have changed; the nudge; the end."""
WINDOW = 1.0
"""How long (s) a swing is looked at: before the nudge and before the end."""
SLICE = 0.02
"""Time (s) between two changes of the gains."""
FAR = 0.01
"""Distance (m) from where it is held at which no nudge leads a platform that comes to rest."""
LEFT = 0.4
"""Share of a nudge that is left in the end from which on it lasts: at the limit of a linear loop that much is."""
HUM = 3.0
"""Times the swing before the nudge that a swing is compared with: a drive may hum all the time."""
LOUDEST = 1e-3
"""m. A larger swing is no hum."""
GAINS = ("kp", "ki", "kd")
NO_LIMIT = {"speed_limit": 1000.0, "dead_zone": 0.0}


class Aftermath(NamedTuple):
    """Swings of the platform, peak to peak about a straight line in the worst direction (m).

    Attributes:
        hum: before the nudge. left: in the end; infinite if the platform went far off, or a component failed.
    """

    hum: float
    left: float

    def lasts(self, nudge: float) -> bool:
        """Whether a `nudge` (m) did not die out."""
        return self.left > max(LEFT * nudge, min(HUM * self.hum, LOUDEST))


def can_be_nudged(experiment: Experiment) -> bool:
    """Whether its loops can be held at a point: [controller.damping] acts only in tasks, and tasks hold nowhere."""
    damping = experiment.controller.damping
    return not experiment.tasks or damping is None or damping.gain == 0.0


def aftermath(experiment: Experiment, point: OperatingPoint, law: str, factor: float, nudge: float) -> Aftermath:
    """What a `nudge` (m) at `point` leaves with `factor` times the gains of `law`, "position" or "force".

    Raises:
        InputRefused: a drive FMU does not fit.
    """
    rows, tick = [], experiment.cosim.tick
    with closing(_heights(held(experiment, point, nudge), law, factor)) as slices:
        for p_B in slices:
            rows.append(p_B)
            if not np.abs(p_B[-1] - point.p_B).max() < FAR:
                return Aftermath(0.0, np.inf)
    p_B = np.vstack(rows)
    width, nudged = round(WINDOW / tick), round(NUDGED / tick)
    if len(p_B) <= round(OVER / tick):
        return Aftermath(0.0, np.inf)
    return Aftermath(swing(p_B[nudged - width : nudged]), swing(p_B[-width:]))


def swing(p_B: Matrix) -> float:
    """Peak to peak of a path (n, 3), each direction about its straight line, the largest of the three."""
    t = np.arange(len(p_B), dtype=float)
    return float(max(np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)) for p in p_B.T))


def held(experiment: Experiment, point: OperatingPoint, nudge: float) -> Experiment:
    """Held at `point` and nudged once; no faults, changes, monitor or moving surface."""
    x, y, z = point.p_B
    period = experiment.controller.period
    nudged = (x + nudge, y + nudge, z + nudge)
    c = experiment.controller
    force = {"reference": point.F_z, "trigger": None, "trigger_time": 0.0, "limit": 1.0}
    mode = "force_position" if point.force_on else "position"
    computer = c.model_copy(update={**NO_LIMIT, "mode": mode, "force": c.force.model_copy(update=force)})
    alone = replace(
        experiment,
        tasks=(),
        approach=None,
        faults=(),
        changes=(),
        monitor=None,
        scale=None,
        contact=experiment.contact.model_copy(update={"breathing": None, "shift": None}),
        reference=WayPoints((0.0, NUDGED - period, NUDGED), (point.p_B, point.p_B, nudged)),
        controller=computer,
        duration_ticks=round(OVER / experiment.cosim.tick),
    )
    return exactly_measured(with_plant(alone, backlash=0.0))


def _heights(experiment: Experiment, law: str, factor: float) -> Iterator[Matrix]:
    """Slices of the platform's path (n, 3) while the gains go evenly, in their logarithm, to `factor` times theirs.

    Gains that are lowered are low from the beginning: with the higher ones the robot may shake.
    """
    with assemble(experiment) as assembly:
        system = assembly.system
        gains = system.component("controller").memory[law]  # type: ignore[attr-defined]
        as_set = {name: gains[name].copy() for name in GAINS}
        ticks = max(1, round(SLICE / system.tick))
        simulation = Simulation(system, experiment.duration_ticks, ticks)
        column = system.columns("plant.p_B")
        while not simulation.finished:
            share = (simulation.next_tick * system.tick - SETTLED) / (RAISED - SETTLED)
            now = factor ** min(max(share, 0.0), 1.0) if factor > 1.0 else factor
            for name, gain in as_set.items():
                gains[name][...] = now * gain
            yield simulation.advance()[:, column].copy()
