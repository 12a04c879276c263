"""What the twin believes of the robot whose log is replayed: the parts of an experiment that a replay needs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from twin.kernel.cosim.delay import named, play
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.recording.logs.log import LogRefused
from twin.kernel.recording.logs.reader import is_recording
from twin.kernel.recording.reader import read
from twin.robot.assembly.build import plant_parameters, surface_motions
from twin.robot.assembly.declared import DECLARED
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import refuse_other_parts
from twin.robot.controller.controller import Belief
from twin.robot.controller.task_controller import Computer
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import sentences, unknown
from twin.robot.experiment.recorded import recorded_name, recorded_values
from twin.robot.experiment.schema import Cosim
from twin.robot.experiment.source import Source, override
from twin.robot.experiment.stand_in import rest_of, role_named
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.component import OUTPUTS, Plant
from twin.robot.plant.contact_law import Body, Contact, Motion
from twin.robot.plant.dynamics import LONGEST_GAP, STATES, PlantParameters, TrueRobot
from twin.robot.plant.encoder import Display

TABLES = {name: DECLARED.tables[name] for name in ("plant", "contact", "cosim", "controller", "scale")}
"""What is read of a recorded experiment; it may lack a scale."""


OWN = ("estimator", "body")
"""Parts that a replay has to know."""


@dataclass(frozen=True)
class RobotModel:
    """The twin of one robot, SI.

    Attributes:
        name: of the experiment.
        values: its tables as far as they are used here, keys with units.
        belief, gravity_compensation: the controller's, for its estimate.
        plant, substeps, motions, tick: the plant model, what moves its surface, and its step (s).
        resolution: of the measured force (N); 0: not known.
    """

    name: str
    values: Mapping[str, Any]
    belief: Belief
    gravity_compensation: bool
    plant: PlantParameters
    substeps: int
    motions: tuple[Motion, ...]
    tick: float
    resolution: float

    @property
    def aware(self) -> Belief:
        """The controller's belief, with the dead zone that the plant has: what can be made of the counts at best."""
        return self.belief._replace(backlash=self.plant.backlash)


def loaded_model(path: Path, settings: Iterable[str] = ()) -> RobotModel:
    """What a replay needs of the experiment file at `path`, with `settings` as of `twin run --set`.

    Raises:
        InputRefused: with every mistake of the experiment.
    """
    return model_of(load_experiment(path, settings))


def model_of(experiment: Experiment) -> RobotModel:
    """What a replay needs of an experiment.

    Raises:
        InputRefused: a part of it is third-party.
    """
    refuse_other_parts(experiment, "a replay", OWN)
    values = {name: experiment.values[name] for name in TABLES if name in experiment.values}
    return _model(experiment.name, values, **{name: getattr(experiment, name) for name in TABLES})


def model_for(log: Path, experiment: Path | None, settings: Sequence[str] = ()) -> RobotModel:
    """What a replay needs of the robot whose log is the file `log`: of `experiment`, or else as the log itself tells.

    Raises:
        InputRefused: it does not tell, or as `loaded_model` and `recorded_model`.
    """
    if experiment is not None:
        return loaded_model(experiment, settings)
    if is_recording(log):
        return recorded_model(read(log).metadata, log, settings)
    raise InputRefused(f"{log}: does not name its robot; give its experiment with --experiment FILE")


def recorded_model(metadata: Mapping[str, Mapping[str, str]], where: Path, settings: Iterable[str] = ()) -> RobotModel:
    """What a replay needs of the experiment that a recording of twin carries with it.

    Args:
        metadata: of the recording.
        where: the recording, for sentences.
        settings: "table.key=value" texts laid over it. [plant] and [controller.model] are filled in there, so a setting
            of [robot] would reach nothing, and is refused like every table that a replay does not read.

    Raises:
        InputRefused: the recording has no experiment, or a setting does not fit.
    """
    name, values = recorded_name(metadata, where), recorded_values(DECLARED, metadata, where)
    if not values:
        raise InputRefused(f"{where}: carries no experiment; name the robot's with --experiment FILE")
    source = Source()
    source.put({table: values[table] for table in TABLES if table in values}, "recorded")
    override(source, settings)
    mistakes = [f"[{table}] {unknown(table, list(TABLES))}" for table in source.values if table not in TABLES]
    checked: dict[str, Any] = {}
    mistakes += [
        f"[{role}] is third-party; only the twin's own can be replayed" for role in OWN if role_named(values, role)
    ]
    for table, schema in TABLES.items():
        if table in source.values or table != "scale":
            try:
                other = role_named(source.values, table)
                checked[table] = (
                    rest_of(DECLARED, table, other) if other else schema.model_validate(source.values.get(table, {}))
                )
            except ValidationError as error:
                mistakes += sentences(error, schema, table)
    if mistakes:
        raise InputRefused(f"{where}, its experiment: {'; '.join(mistakes)}")
    return _model(name, source.values, **checked)


def _model(
    name: str, values: Mapping[str, Any], plant: TrueRobot, contact: Contact, cosim: Cosim, controller: Computer,
    scale: Display | None = None,
) -> RobotModel:  # fmt: skip
    return RobotModel(
        name=name,
        values=values,
        belief=Belief.made(controller, controller.model),
        gravity_compensation=controller.gravity_compensation,
        plant=plant_parameters(plant, contact),
        substeps=plant.substeps,
        motions=surface_motions(contact),
        tick=cosim.tick,
        resolution=scale.resolution * G_ACCELERATION if scale and scale.resolution else 0.0,
    )


SETTLING = 1.0
"""s, before each start, with the motors where the first sample has them: 20 time constants of the springs' swing with
the robot's joint friction, and 5 of a robot with a quarter of it."""


def motions(
    model: RobotModel, t: NDArray[np.float64], theta_m: NDArray[np.float64], p_B: NDArray[np.float64]
) -> tuple[dict[str, NDArray[np.float64]], list[float]]:
    """What the plant model does under the motor angles of a log.

    It starts at rest, settled, where the log's first sample has the robot; and again after every gap longer than
    `LONGEST_GAP`. What friction held before is forgotten then.

    Args:
        model: the twin.
        t: times of the samples (n,), s, ascending.
        theta_m: motor angles (n, 3), rad.
        p_B: the robot's position by its encoders (n, 3), m, for the starts.

    Returns:
        The plant's outputs by port at every sample, (n,) or (n, size), SI; and the times (s) of all starts.

    Raises:
        LogRefused: samples too far apart to know the motors' way.
        ComponentFailed: the model left the workspace.
    """
    if np.median(np.diff(t)) > LONGEST_GAP:
        raise LogRefused(
            f"a sample every {np.median(np.diff(t)):.3g} s; the plant model needs one every {LONGEST_GAP:g} s or sooner"
        )
    bounds = [0, *(np.flatnonzero(np.diff(t) > LONGEST_GAP) + 1), len(t)]
    parts = [_stretch(model, t[a:b], theta_m[a:b], p_B[a]) for a, b in pairwise(bounds)]
    joined = {port.name: np.concatenate([part[port.name] for part in parts]) for port in OUTPUTS}
    return joined, [float(t[a]) for a in bounds[:-1]]


class PlantRun:
    """The plant model driven by motor angles, from rest on, in pieces of any length.

    It settles first, so that the first sample is what the model starts from.

    Args:
        model: the twin.
        p_B: where the robot is at the first sample (3,), m.
    """

    def __init__(self, model: RobotModel, p_B: NDArray[np.float64]):
        self._model, self._p_B = model, p_B
        self._plant: Plant | None = None
        self._t, self._theta_m = 0.0, np.zeros(3)
        self._body = Body(model.motions) if model.motions else None

    def advance(self, t: NDArray[np.float64], theta_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
        """Go on to the samples at `t` (n,), s, with motor angles `theta_m` (n, 3), rad.

        Returns:
            The plant's outputs at them, fewer if it failed, and then why.
        """
        model, begins = self._model, self._plant is None
        if begins:
            x = np.zeros(STATES)
            x[:3] = self._p_B
            self._plant = Plant(model.plant, x, theta_m[0], model.substeps, bool(model.motions))
            self._start, self._elapsed = t[0] - SETTLING, 0.0
            self._outputs = self._plant.initial_outputs
            settling = [int(np.ceil(SETTLING / model.tick))]
            known, angles = t, theta_m
        else:
            settling = []
            known, angles = np.concatenate([[self._t], t]), np.vstack([self._theta_m, theta_m])
        assert self._plant is not None
        steps = np.array([*settling, *np.maximum(1, np.ceil(np.diff(known) / model.tick - 1e-6))], dtype=np.int64)
        lengths = np.array([*([SETTLING] if begins else []), *np.diff(known)])
        h = np.repeat(lengths / steps, steps)
        elapsed = np.cumsum([self._elapsed, *h])[1:]
        ends = self._start + elapsed
        u = np.stack([np.interp(ends, known, angles[:, i]) for i in range(3)], axis=1)
        if self._body is not None:
            ground, _ = play(self._body, ends - h, h, np.empty((len(h), 0)))
            if begins:
                ground[: steps[0]] = [*ground[steps[0] - 1][:3], 0.0, 0.0, 0.0]
            u = np.hstack([u, ground])
        rows, status = play(self._plant, ends - h, h, u, steps, self._outputs)
        if status:
            return rows, self._plant.explain(status)
        self._t, self._theta_m, self._elapsed, self._outputs = float(t[-1]), theta_m[-1], elapsed[-1], rows[-1]
        return rows, ""


def _stretch(
    model: RobotModel, t: NDArray[np.float64], theta_m: NDArray[np.float64], p_B: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """The plant's outputs at the samples of a stretch without long gaps."""
    rows, failure = PlantRun(model, p_B).advance(t, theta_m)
    if failure:
        raise ComponentFailed(
            f"the plant model, driven by the log's motor angles, {failure} before "
            f"t = {t[len(rows)]:.3f} s; does the experiment describe this robot?"
        )
    return named(OUTPUTS, rows)
