"""What the twin believes of the robot whose log is replayed: the parts of an experiment that a replay needs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.kernel.errors import InputRefused
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
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, TrueRobot
from twin.robot.plant.encoder import Display
from twin.robot.plant.surface_motion import Motion

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
