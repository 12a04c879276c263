"""Commented template of an experiment: every table and key, with its meaning, bounds and a value.

It is generated from the models that check an experiment, so its keys are always complete and current.
"""

import json
import math
import os
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from twin.kernel.atomic_write import make_folder, write_text
from twin.kernel.errors import InputRefused, nearest
from twin.robot.experiment import schema
from twin.robot.experiment.experiment import TopLevelKeys
from twin.robot.experiment.experiment_files import fill_from_body, known_experiments
from twin.robot.experiment.fault import FAULT_KINDS, fault_table_model
from twin.robot.experiment.json_schema import SCHEMA_FILE, schema_text
from twin.robot.experiment.measure import MEASURE_KINDS as MEASURES
from twin.robot.experiment.mistakes import nested_model
from twin.robot.experiment.robot_file import fit_to_robot
from twin.robot.experiment.schema import ChangeTable, DeclaredTables
from twin.robot.experiment.source import RETAINED_KEYS, Source, is_robot, read_source, toml_value, value_at
from twin.robot.experiment.stand_in import StandIn
from twin.robot.paths import locate_file

ROBOT_FILE = "robots/massage_robot.toml"
FIG4_EXPERIMENT, TASK_EXPERIMENT = "fig4_force_position", "massage"
EXAMPLE_FILES = (f"{FIG4_EXPERIMENT}.toml", f"{TASK_EXPERIMENT}.toml")
"""Source files of example values for unused tables and keys."""
EXAMPLE_FAULT = "surface_jump"
EXAMPLE_CHANGE = {"t_s": 8.0, "key": "controller.force.reference_N", "value": 6.0}
EXAMPLE_MEASURE = {
    "kind": "tracking",
    "name": "force",
    "signal": "-plant.F_ee_B[2]",
    "reference": "controller.F_z_ref",
    "begin_s": 10.0,
    "until_s": 18.7,
}

Table = Mapping[str, Any]


def commented_robot(declared: DeclaredTables, name: str, own: Source, remarks: Collection[str]) -> str:
    """Return a commented file of a robot: its own values, and every other key of its tables, commented out.

    Args:
        name: name of the new file.
        own: active values and their sources.
        remarks: consequences of the values, at the end of the file.
    """
    shipped = read_source(locate_file(f"experiments/{ROBOT_FILE}", Path.cwd()))
    own = Source(own.values, {**shipped.origins, **own.origins})
    page = _TemplateWriter(own, shipped.values, {})
    lines = [
        f"#:schema {SCHEMA_FILE}",
        f"# Look at it: {shlex.join(['twin', 'robot', name])}",
        f"# Press with it: {shlex.join(['twin', 'init', 'press.toml', '--robot', name])}, then twin run press.toml",
        "#",
        "# A key's unit is in its name. A value whose source begins with 'computed' follows from the lengths. Lines",
        f"# with # are not set: keys of [robot] are inherited from {ROBOT_FILE}, others show the",
        "# default, or an example where there is none. Remove the # and set the robot's own value, with its source.",
        "",
        "# file with values for all keys that this one does not set",
        f'extends = "{ROBOT_FILE}"',
    ]
    for table, values in own.values.items():
        model = declared.tables[table]
        # all but the height of a surface is the body's
        left_out = _plain_keys(model).keys() - values.keys() if table == "contact" else ()
        head = "place of the surface; the body has the rest" if table == "contact" else _summary(model)
        lines += ["", f"# {head}", f"[{table}]", *page.keys(table, model, values, page.origins(table), left_out)]
    return "\n".join([*lines, "", *(f"# {remark}" for remark in remarks)]) + "\n"


def commented_experiment(
    declared: DeclaredTables, name: str, base: Path, robot: Path | None = None, extends: str = ROBOT_FILE
) -> str:
    """Return a commented template of an experiment: an existing one plus every other key, commented out.

    Values of `base` in tables other than [robot] are active; of [plant], only values that the robot's file lacks. All
    other lines begin with "#" and show the value of body or robot, the default, or an example.

    Args:
        name: name of the new file.
        base: one of the repository's experiments.
        robot: file of another robot; None for the shipped one.
        extends: path of the robot's file, as seen from the new one.

    Raises:
        InputRefused: a file of the repository is missing, or `robot` is not a robot's file.
    """
    own, filled, others = read_source(base), read_source(base), Source()
    fill_from_body(filled, base.parent)
    inherited = read_source(robot or locate_file(f"experiments/{ROBOT_FILE}", base.parent)).values
    if robot is not None:
        if not is_robot(inherited):
            raise InputRefused(f"{robot}: not a robot file; expected one that twin init --robot has written")
        fit_to_robot(own, filled, read_source(robot))
    for other in EXAMPLE_FILES:
        others.merge(read_source(locate_file(other, base.parent)).values, "")
    page = _TemplateWriter(own, filled.values, others.values)
    models: dict[str, type[BaseModel]] = {"cosim": schema.Cosim, "drive": schema.Drive, **declared.tables}
    lines = [
        f"#:schema {SCHEMA_FILE}",
        f"# Run this: {shlex.join(['twin', 'run', name])}",
        "#",
        "# A key's unit is in its name. Lines with # are not set; they show the default, or an example where there is",
        '# none. Any value may be { value = 5.0, source = "where it comes from" }.',
        "",
        "# file with values for all keys that this one does not set",
        f"extends = {toml_value(extends)}",
        *page.keys("", TopLevelKeys, own.values, page.origins("")),
    ]
    for table, model in models.items():
        if table not in ("robot", "plant"):
            lines += page.table(table, model)
    kind = FAULT_KINDS[EXAMPLE_FAULT]
    assert kind.magnitudes is not None and kind.magnitude_key is not None
    fault = {"kind": EXAMPLE_FAULT, "target": kind.targets[0], "onset_s": 3.0, kind.magnitude_key: kind.magnitudes[1]}
    sections = {
        "Tasks stand instead of [reference]; they need [approach], [controller.touch], .feed_forward and .damping.": (
            page.array("task", declared.tasks, others.values["task"])
        ),
        "Faults: docs/faults_reference.md has every kind.": page.item("fault", fault_table_model(kind), fault, "#", {}),
        "Scheduled changes of the controller.": page.array("change", {None: ChangeTable}, (EXAMPLE_CHANGE,)),
        "Measures of twin check: docs/regression.md has every kind.": (
            page.array("measure", MEASURES, (EXAMPLE_MEASURE,))
        ),
    }
    for remark, section in sections.items():
        lines += ["", f"# {remark}", *section]
    lines += ["", "# The robot as the file that this one extends has it.", "#[robot]"]
    whole = _plain_keys(declared.tables["robot"])
    lines += page.keys("robot", declared.tables["robot"], {}, {})
    plant = inherited.get("plant", {})
    true = {key: value for key, value in (value_at(own.values, "plant") or {}).items() if plant.get(key) != value}
    origins = page.origins("plant")
    lines += [
        "",
        "# The true robot where it differs from [robot]: any key of it. The controller does not know it.",
        f"{'' if true else '#'}[plant]",
        *page.keys("plant", declared.tables["plant"], true, origins, whole),
    ]
    lines += [_line(k, value, "", origins.get(k)) for k, value in true.items() if k in whole]
    return "\n".join(lines) + "\n"


class _TemplateWriter:
    """Writer of a commented experiment template; tables and keys without an active value are commented out.

    `own` has the active values, `nearer` and `farther` other values, tried before and after the default.
    """

    def __init__(self, own: Source, nearer: Table, farther: Table):
        self._own, self._nearer, self._farther = own, nearer, farther

    def origins(self, table: str) -> Table:
        """Return the stated sources of a table's values by key, without origins that are mere file names."""
        prefix = f"{table}." if table else ""
        found = {k.removeprefix(prefix): text for k, text in self._own.origins.items() if k.startswith(prefix)}
        return {key: text for key, text in found.items() if not text.startswith("set in ")}

    def table(self, name: str, model: type[BaseModel]) -> list[str]:
        """Return the template's lines of one table and the tables nested in it."""
        own = value_at(self._own.values, name)
        mark = "#" if own is None else ""
        lines = ["", f"# {_summary(model)}", f"{mark}[{name}]", *self.keys(name, model, own or {}, self.origins(name))]
        fields = model.model_fields
        if name in RETAINED_KEYS and model is not StandIn:
            lines += [
                "# Instead of twin's own, an FMU or a Python class: docs/roles.md.",
                *self.keys(name, StandIn, own or {}, self.origins(name)),
            ]
            fields = {**fields, **StandIn.model_fields}
        for field, info in fields.items():
            inner, path = nested_model(info.annotation), f"{name}.{info.alias or field}"
            if get_origin(info.annotation) is dict:
                entries = value_at(self._own.values, path) or {}
                lines += ["", f"# {info.description}", f"{'' if entries else '#'}[{path}]"]
                lines += [_line(key, value, "", self.origins(path).get(key)) for key, value in entries.items()]
            elif path == "controller.model":
                lines += ["", "# The controller's belief where it differs from [robot]: any key of it.", f"#[{path}]"]
            elif inner is not None and get_origin(info.annotation) is tuple:
                entries = value_at(self._own.values, path)
                for entry in entries or (info.examples or [()])[0]:
                    lines += self.item(path, inner, entry, "" if entries else "#", {})
            elif inner is not None:
                lines += self.table(path, inner)
        return lines

    def array(self, name: str, models: Mapping[Any, type[BaseModel]], others: tuple[Table, ...]) -> list[str]:
        """Return the template's lines of an array of tables; without active tables, examples commented out."""
        lines, own = [], self._own.values.get(name)
        for number, table in enumerate(own or others, start=1):
            origins = self.origins(f"{name}.{number}") if own else {}
            lines += self.item(name, models[table.get("kind")], table, "" if own else "#", origins)
        return lines

    def item(self, name: str, model: type[BaseModel], values: Table, mark: str, origins: Table) -> list[str]:
        """Return the template's lines of one table in an array of tables."""
        lines = ["", f"# {_summary(model)}", f"{mark}[[{name}]]"]
        lines += [f'{mark}kind = "{values["kind"]}"'] if "kind" in values else []
        for key, info in _plain_keys(model).items():
            if key != "kind":
                value, own = (values[key], mark) if key in values else (_default_or_example(info), "#")
                lines += [f"# {_meaning(info)}", _line(key, value, own, origins.get(key))]
        return lines

    def keys(
        self, table: str, model: type[BaseModel], own: Table, origins: Table, without: Collection[str] = ()
    ) -> list[str]:
        """Return the template's lines of a table's keys, each below its meaning."""
        lines = []
        for key, info in _plain_keys(model).items():
            if key in without:
                continue
            path = f"{table}.{key}" if table else key
            candidates = (value_at(self._nearer, path), _default_or_example(info), value_at(self._farther, path))
            instead = next((value for value in candidates if value is not None), None)
            value, mark = (own[key], "") if key in own else (instead, "#")
            lines += [f"# {_meaning(info)}", _line(key, value, mark, origins.get(key))]
        return lines


def _plain_keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the pydantic fields of a table's model that are single keys, not nested tables."""
    return {
        info.alias or field: info
        for field, info in model.model_fields.items()
        if nested_model(info.annotation) is None and get_origin(info.annotation) is not dict
    }


def _default_or_example(info: FieldInfo) -> Any:
    """Return the default value of a key; if it has no default, an example."""
    if info.is_required() or info.default is None:
        return (info.examples or [None])[0]
    return info.default


def _meaning(info: FieldInfo) -> str:
    """Return meaning, bounds and choices of a key as a comment: `largest command; > 0`."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{sign} {getattr(bound, name):g}"
        for bound in info.metadata
        for name, sign in signs.items()
        # 2**63 is a technical bound
        if abs(getattr(bound, name, math.inf)) < 1e18
    ]
    kinds = (info.annotation, *get_args(info.annotation))
    choices = [json.dumps(value) for kind in kinds if get_origin(kind) is Literal for value in get_args(kind)]
    return "; ".join(filter(None, (info.description, " and ".join(bounds), " or ".join(choices))))


def _summary(model: type[BaseModel]) -> str:
    """Return the first sentence of a table model's docstring."""
    text = " ".join((model.__doc__ or "").split("\n\n")[0].split())
    return (text.partition(": ")[2] or text).removesuffix(".")


def _line(key: str, value: Any, mark: str, source: str | None = None) -> str:
    written = f"{{ value = {toml_value(value)}, source = {toml_value(source)} }}" if source else toml_value(value)
    return f"{mark}{key} = {written}"


def shipped_experiment(start: str) -> Path:
    """Return the file of a shipped experiment."""
    known = known_experiments()
    if start not in known:
        raise InputRefused(f"--from {start}: no such experiment; {nearest(start, known)}")
    return known[start]


def start_experiment(declared: DeclaredTables, file: Path, start: str, robot: Path | None = None) -> list[Path]:
    """Write a new experiment file that is equivalent to a shipped experiment, or to that on another robot.

    Raises:
        InputRefused: `start` is unknown, or `robot` is not a robot's file; see also `write_new`.
    """
    base = shipped_experiment(start)
    extends = ROBOT_FILE if robot is None else os.path.relpath(robot, file.parent)
    return write_new(declared, file, commented_experiment(declared, file.name, base, robot, extends))


def write_new(declared: DeclaredTables, file: Path, text: str) -> list[Path]:
    """Write a new TOML file, and the JSON Schema beside it if missing; return the written files.

    Raises:
        InputRefused: `file` exists, or is not named *.toml.
        NotWritten: a file cannot be written.
    """
    if file.suffix != ".toml":
        raise InputRefused(f"{file}: expected a name that ends with .toml")
    schema = file.parent / SCHEMA_FILE
    make_folder(file.parent)
    if os.path.lexists(file):
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name")
    write_text(file, text)
    if os.path.lexists(schema):
        return [file]
    write_text(schema, schema_text(declared))
    return [file, schema]
