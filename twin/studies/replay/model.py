"""Belief about a robot: the parts of an experiment that a replay needs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.reader import is_recording
from twin.kernel.recording.reader import read
from twin.robot.assembly.build import plant_parameters, surface_motions
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.controller.controller import Belief
from twin.robot.controller.task_controller import Computer
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import error_messages, unknown_key
from twin.robot.experiment.recorded import recorded_name, recorded_values
from twin.robot.experiment.schema import Cosim
from twin.robot.experiment.source import Source, apply_overrides
from twin.robot.experiment.stand_in import find_stand_in_table, retained_settings
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, TrueRobot
from twin.robot.plant.encoder import Display
from twin.robot.plant.surface_motion import Motion

MODEL_TABLES = {name: DECLARED_TABLES.tables[name] for name in ("plant", "contact", "cosim", "controller", "scale")}
"""Tables of a recorded experiment that are used; the scale may be missing."""
OWN_PARTS = ("estimator", "body")


@dataclass(frozen=True)
class RobotModel:
    """Belief about one robot, SI: controller model, plant parameters and sensor resolution.

    Attributes:
        values: the used tables of the experiment, keys with units.
        belief, gravity_compensation: belief and setting of the controller's estimator.
        plant, substeps, motions, tick: parameters of the plant, motions of its surface, and its step (s).
        resolution: resolution of the measured force (N); 0 if unknown.
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
    def belief_with_dead_zone(self) -> Belief:
        """Controller's belief about the robot plus the plant's dead zone, for the best estimate from the counts."""
        return self.belief._replace(backlash=self.plant.backlash)


def model_of(experiment: Experiment) -> RobotModel:
    refuse_third_party_parts(experiment, "a replay", OWN_PARTS)
    values = {name: experiment.values[name] for name in MODEL_TABLES if name in experiment.values}
    return _model(experiment.name, values, **{name: getattr(experiment, name) for name in MODEL_TABLES})


def model_for(log: Path, experiment: Path | None, settings: Sequence[str] = ()) -> RobotModel:
    """Load the believed robot for a log file: from `experiment`, or else from the recording's own experiment."""
    if experiment is not None:
        return model_of(load_experiment(experiment, settings))
    if is_recording(log):
        return recorded_model(read(log).metadata, log, settings)
    raise InputRefused(f"{log}: does not name its robot; give its experiment with --experiment FILE")


def recorded_model(metadata: Mapping[str, Mapping[str, str]], where: Path, settings: Iterable[str] = ()) -> RobotModel:
    """Extract the believed robot from the experiment in a recording's metadata.

    Args:
        where: path of the recording, for error messages.
        settings: "table.key=value" texts. [plant] and [controller.model] are expanded in a recording, so that settings
            of [robot] would have no effect; they are refused, like settings of unused tables.
    """
    name, values = recorded_name(metadata, where), recorded_values(DECLARED_TABLES, metadata, where)
    if not values:
        raise InputRefused(f"{where}: carries no experiment; name the robot's with --experiment FILE")
    source = Source()
    source.merge({table: values[table] for table in MODEL_TABLES if table in values}, "recorded")
    apply_overrides(source, settings)
    mistakes = [
        f"[{table}] {unknown_key(table, list(MODEL_TABLES))}" for table in source.values if table not in MODEL_TABLES
    ]
    others = [role for role in OWN_PARTS if find_stand_in_table(values, role)]
    mistakes += [f"[{role}] is third-party; only the twin's own can be replayed" for role in others]
    checked: dict[str, Any] = {}
    for table, schema in MODEL_TABLES.items():
        if table in source.values or table != "scale":
            try:
                if other := find_stand_in_table(source.values, table):
                    checked[table] = retained_settings(DECLARED_TABLES, table, other)
                else:
                    checked[table] = schema.model_validate(source.values.get(table, {}))
            except ValidationError as error:
                mistakes += error_messages(error, schema, table)
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
        belief=Belief.from_tables(controller, controller.model),
        gravity_compensation=controller.gravity_compensation,
        plant=plant_parameters(plant, contact),
        substeps=plant.substeps,
        motions=surface_motions(contact),
        tick=cosim.tick,
        resolution=scale.resolution * G_ACCELERATION if scale and scale.resolution else 0.0,
    )
