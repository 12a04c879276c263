"""What truly happened in an experiment, whatever the robot's controller believes of it, as curves and as numbers."""

import numpy as np

from twin.controller.phase import PhaseKind
from twin.runs.trace import Trace
from twin.studies.metrics.response import Curve, first_time, overshoot, rms, settling_time
from twin.studies.qualify.definitions import Definition, Measure

BAND = 0.05
"""Share of the reference (force) or of its last change (position) within which the robot has settled."""
STILL = 1e-9
"""m per tick. Rounding moves a reference that stands still by far less, any real motion by far more."""
COMPARED = {
    "settling_time": Definition(
        "settles", "s",
        "from the trigger of the force loop, or from the first touch if that is later, until the true pressing force "
        "stays within 5 % of its reference; where "
        "nothing triggers, from the end of the z reference's last change until the true z stays within 5 % of it; "
        "not for tasks, which lead the force along a ramp",
    ),
    "overshoot": Definition(
        "overshoot", "%",
        "of the same quantity beyond its reference, after the same moment, by force or by change; in tasks of the "
        "force beyond its largest reference, while the force loop is on",
    ),
    "rms_force_error": Definition(
        "rms F_z", "N",
        "root mean square of the true pressing force minus its reference, second half of the run, from the first touch "
        "on; in tasks while they hold, circle or push",
    ),
    "rms_z_error": Definition(
        "rms z", "m",
        "root mean square of the true z minus its pre-defined reference, in tasks minus what the force loop makes of "
        "it, second half of the run",
    ),
    "peak_current": Definition("peak I", "A", "largest current of any of the three drives, where they tell it"),
    "shaft_work": Definition(
        "work", "J", "work the three shafts do on the springs, what they get back not counted: tau_load omega_m > 0",
    ),
    "energy": Definition("energy", "J", "electrical energy the three drives draw, where they tell their power"),
    "cost": Definition("cost", "s", "wall time in the step functions of the three drives, per tick"),
}  # fmt: skip

UNDER_FORCE = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
"""Phases in which a task holds its force."""


class TrueRun:
    """A robot's `run`, every tick and signal of it.

    Attributes:
        t: s, (ticks,), as all of them.
        F_z, F_z_ref: true pressing force, and what it should be while the force loop is on (N).
        z, z_ref: true height of the platform; pre-defined, before the force loop shifts it, in tasks after that (m).
    """

    def __init__(self, run: Trace):
        # tasks lead the robot, not way points
        self.run, self._tasks = run, "controller.task" in run.fields()
        self.t: Curve = run.t
        self.F_z: Curve = -run["plant.F_ee_B"][:, 2]
        self.F_z_ref: Curve = run.held("controller.F_z_ref")
        self.z: Curve = run["plant.p_B"][:, 2]
        self.z_ref: Curve = run.held("controller.p_cmd_B" if self._tasks else "controller.p_ref_B")[:, 2]

    def measures(self, cost: float) -> tuple[Measure, ...]:
        """All of `COMPARED`.

        Args:
            cost: wall time in the drives per tick (s).
        """
        late = np.arange(len(self.t)) >= len(self.t) // 2
        pressing = np.isin(self.run.held("controller.phase"), UNDER_FORCE) if self._tasks else late
        touching = bool(np.any(self.F_z[pressing] > 0.0))
        if not self._tasks:
            pressing = late & (self.t >= first_time(self.t, self.F_z > 0.0))
        # taps are no holding, however hard
        untold = "no contact" if np.any(pressing) else "no task holds a force"
        shaft_power = self.run["plant.tau_load"] * self.run.of_drives("omega_m")
        current, power = self.run.of_drives("current"), self.run.of_drives("power")
        return (
            *self._approach(),
            Measure(
                "rms_force_error",
                rms(self.F_z[pressing] - self.F_z_ref[pressing]) if touching else None,
                "" if touching else untold,
            ),
            Measure("rms_z_error", rms(self.z[late] - self.z_ref[late])),
            _told("peak_current", float(np.max(np.abs(current))) if current.size else None),
            Measure("shaft_work", self._integral(np.maximum(0.0, shaft_power))),
            _told("energy", self._integral(power) if power.size else None),
            Measure("cost", cost),
        )

    def _approach(self) -> tuple[Measure, Measure]:
        """Measures `settling_time` and `overshoot`: of the force once it is controlled, else of the height."""
        on = self.run.held("controller.triggered")
        if self._tasks:
            beyond = 100.0 * overshoot(self.F_z[on], float(self.F_z_ref[on].max())) if np.any(on) else None
            ramp = Measure("settling_time", None, "a task has no step")
            return ramp, Measure("overshoot", beyond, "" if np.any(on) else "the force loop is never on")
        triggered = first_time(self.t, on)
        if np.isfinite(triggered):
            # a loop that is on in the air has nothing to settle yet
            touched = first_time(self.t, self.F_z > 0.0)
            start = max(triggered, touched) if np.isfinite(touched) else triggered
            return self._approached(start, self.F_z, float(self.F_z_ref[-1]))
        moving = np.flatnonzero(np.abs(np.diff(self.z_ref)) > STILL)
        if len(moving) == 0:
            still = "z is to stay where it is"
            return Measure("settling_time", None, still), Measure("overshoot", None, still)
        # the last change of the reference begins after the last pause in it
        pauses = np.flatnonzero(np.diff(moving) > 1)
        before = float(self.z_ref[moving[pauses[-1] + 1] if len(pauses) else moving[0]])
        change = float(self.z_ref[-1]) - before
        return self._approached(float(self.t[moving[-1] + 1]), (self.z - before) * np.sign(change), abs(change))

    def _approached(self, start: float, y: Curve, target: float) -> tuple[Measure, Measure]:
        after = self.t >= start
        settled = settling_time(self.t[after], y[after], target, BAND * target) - start
        return (
            Measure("settling_time", settled)
            if np.isfinite(settled)
            else Measure("settling_time", None, "not in this run"),
            Measure("overshoot", 100.0 * overshoot(y[after], target)),
        )

    def _integral(self, power: np.ndarray) -> float:
        """Energy (J) of `power` (ticks, n), W, held from tick to tick."""
        return float(np.sum(power[:-1]) * self.run.tick)


def _told(name: str, value: float | None) -> Measure:
    return Measure(name, value, "" if value is not None else "the drive does not tell")
