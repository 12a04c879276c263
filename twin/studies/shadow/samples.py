"""What a robot sends, as the filter takes it: of a recording or a run in memory; and what the filter makes of it."""

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import columns, play
from twin.kernel.cosim.port import by_port, places, width
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.build import belief, planned_drives, plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.view import RunView, sample_and_hold
from twin.studies.converge.monolith import servos
from twin.studies.shadow.filter import Shadow
from twin.studies.shadow.layout import INPUTS, OUTPUTS, Noises, Sensors, ShadowDrive

Columns = dict[str, NDArray[np.float64]]
UNKNOWN_DRIVE = ShadowDrive(lag=0.02, droop=0.0, inertia=1e-4, wander=20.0)
"""Of a drive whose equations are not known: the lag that a controller believes, and much that it does besides."""
KNOWN_DRIVE = 0.1
"""rad/s2/sqrt(Hz). A lag of 20 ms that is 1 % off is as much, at 10 rad/s2 that change ten times a second."""


COUNT_M, COUNT_L, OMEGA_REF, F_Z, TAU = (places(INPUTS)[port.name] for port in INPUTS)
"""Columns of a sample."""


class RobotSamples(NamedTuple):
    """Samples of a robot, n of them, in order of time.

    Attributes:
        t: sampling times (n,), s, ascending, by the robot's clock.
        u: inputs of the filter by `layout.INPUTS` (n, 13), SI; NaN where none has come since the sample before. Counts
            made of angles are no whole numbers.
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]

    def held_commands(self, omega_ref: NDArray[np.float64]) -> "RobotSamples":
        """The samples with each command held until the next; omega_ref: commands (3,) before the first, rad/s."""
        commanded = np.vstack([omega_ref, self.u[:, OMEGA_REF]])
        newest = np.maximum.accumulate(np.where(np.isnan(commanded), 0, np.arange(len(commanded))[:, None]), axis=0)
        u = self.u.copy()
        u[:, OMEGA_REF] = np.take_along_axis(commanded, newest, axis=0)[1:]
        return self._replace(u=u)

    def only(self, name: str) -> NDArray[np.float64]:
        """The columns of the input `name`, (n, size), a view."""
        return self.u[:, places(INPUTS)[name]]

    @property
    def periods(self) -> NDArray[np.float64]:
        """Time since the sample before (n,), s; of the first one infinity."""
        return np.diff(self.t, prepend=-np.inf)


def samples_of(run: RunView) -> RobotSamples:
    """The samples that the computer of the robot of `run` had: counts, its commands, what was measured besides.

    Of a robot with broken encoders the counts are what they gave. A measured force is there at its own times only.

    Raises:
        InputRefused: there are no counts.
    """
    has = run.fields()
    if "encoder.count_m" not in has or "encoder.count_l" not in has:
        raise InputRefused("no encoder.count_m and encoder.count_l: a shadow needs the counts of all six encoders")
    t = run.time("encoder")
    u = np.full((len(t), width(INPUTS)), np.nan)
    taken = RobotSamples(t, u)
    for name in ("count_m", "count_l"):
        faults = [int(m[1]) for key in has if (m := re.fullmatch(rf"fault/(\d+)\.{name}", key))]
        topic = f"fault/{max(faults)}" if faults else "encoder"
        taken.only(name)[:] = sample_and_hold(run, f"{topic}.{name}", t)
    if "controller.omega_ref" in has:
        taken.only("omega_ref")[:] = sample_and_hold(run, "controller.omega_ref", t)
    for leg in range(3):
        key = f"drive/{leg + 1}.tau_motor"
        if key in has:
            taken.only("tau_motor")[:, leg] = sample_and_hold(run, key, t)
    if "scale.F_z" in has:
        measured = run.time("scale")
        at = np.searchsorted(t, measured)
        there = at < len(t)
        taken.only("F_z")[at[there], 0] = run["scale.F_z"][there]
    return taken


def shadow_of(experiment: Experiment, noises: Noises = Noises()) -> Shadow:  # noqa: B008, it is a tuple
    """The filter beside the robot that `experiment` describes, before the first sample.

    Raises:
        InputRefused: a drive does not fit.
    """
    plant = experiment.plant
    return Shadow(
        plant_parameters(plant, experiment.contact),
        belief(experiment),
        Sensors(plant.motor_noise, plant.joint_noise),
        drive_model(experiment),
        noises,
    )


def drive_model(experiment: Experiment) -> ShadowDrive:
    """What is known of the drives of `experiment`: all of `velocity_servo`'s equations, little of any other.

    Raises:
        InputRefused: a drive does not fit.
    """
    known = servos(planned_drives(experiment))
    if known is None:
        return UNKNOWN_DRIVE
    lag, droop, inertia = (float(np.mean(values)) for values in (known.T_m, known.droop, known.J_m))
    return ShadowDrive(lag, droop, inertia, KNOWN_DRIVE)


class FilterFeed:
    """A filter that is given its samples one by one, as they come; nothing is allocated for one.

    Args:
        shadow: the filter.

    Attributes:
        u: the sample that is taken next (13,), by `layout.INPUTS`; NaN in the beginning.
        inputs: views of it by port.
        y: what the filter said last (24,), by `layout.OUTPUTS`.
        outputs: views of it by port.
    """

    def __init__(self, shadow: Shadow):
        self._shadow, self._last = shadow, -np.inf
        self.u, self.y = np.full(width(INPUTS), np.nan), np.zeros(width(OUTPUTS))
        self._step, self._at = shadow.step.called_at_once, (self.u.ctypes.data, self.y.ctypes.data)
        self.inputs, self.outputs = by_port(INPUTS, self.u), by_port(OUTPUTS, self.y)

    def __call__(self, t: float) -> None:
        """Take the sample of time `t` (s), later than the one before, that lies in `u`.

        Raises:
            ComponentFailed: it is the first, and its counts fit no pose.
        """
        status = self._step(self._shadow.self_address, t, t - self._last, *self._at)
        if status:
            raise ComponentFailed(f"shadow {self._shadow.explain(status)}, t = {t:.3f} s")
        self._last = t


def followed(shadow: Shadow, samples: RobotSamples) -> Columns:
    """What the filter says at each of `samples`, by `layout.OUTPUTS`: (n,), or (n, size); it goes on from where it is.

    Raises:
        ComponentFailed: its first counts fit no pose.
    """
    h = samples.periods
    rows, status = play(shadow, samples.t, np.where(np.isfinite(h), h, 1e9), samples.u)
    if status:
        raise ComponentFailed(f"shadow {shadow.explain(status)}, t = {samples.t[len(rows)]:.3f} s")
    return columns(shadow, rows)
