"""What the parts of the robot declare of an experiment's tables, as it is handed to who reads them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydantic import create_model

from twin.kernel.settings import Settings
from twin.robot.experiment.mistakes import keys, model_in
from twin.robot.experiment.source import KEPT


class Changeable(NamedTuple):
    """A setting that may change while an experiment runs: its table, and its name there."""

    table: type[Settings]
    name: str


def nested(model: type[Settings], path: str) -> dict[str, type[Settings]]:
    """The table `model` at the dotted `path`, and all tables in it, by their paths."""
    found = {path: model}
    for name, info in model.model_fields.items():
        inner = model_in(info.annotation)
        if inner is not None and issubclass(inner, Settings):
            found |= nested(inner, f"{path}.{info.alias or name}")
    return found


@dataclass(frozen=True, eq=False)
class Declared:
    """The tables that an experiment may have, and what of them may change while it runs.

    Attributes:
        needed: tables without which there is no experiment, by name, in the order of documents.
        optional: the other tables.
        changeable: by the key in the file.
        tasks: tables of [[task]], by their key `kind`.
        tables: all of them.
    """

    needed: Mapping[str, type[Settings]]
    optional: Mapping[str, type[Settings]]
    changeable: Mapping[str, Changeable] = field(default_factory=dict)
    tasks: Mapping[str, type[Any]] = field(default_factory=dict)

    @property
    def tables(self) -> dict[str, type[Settings]]:
        return {**self.needed, **self.optional}

    def rest(self, role: str) -> type[Settings]:
        """The table [role] where the part is of another make: of twin's own only what acts all the same is needed."""
        model = self.tables[role]
        idle: dict[str, Any] = {
            name: (Any, None)
            for name, info in model.model_fields.items()
            if info.is_required() and (info.alias or name) not in KEPT[role]
        }
        return create_model(model.__name__, __base__=model, **idle) if idle else model

    def model_keys(self) -> list[str]:
        """The keys of [controller.model], which are the robot's own where it does not say otherwise."""
        model = model_in(self.tables["controller"].model_fields["model"].annotation)
        return [] if model is None else keys(model)
