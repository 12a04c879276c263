"""Experiment files as nested dictionaries: TOML, `extends`, `{ value, source }`, `--set`.

A table that names a whole, such as a drive or a third-party part, replaces the same table of the extended files.
Files of other kinds are recognised by their tables and refused.
"""

import contextlib
import copy
import functools
import json
import os
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_DEPTH, MAX_TOML_BYTES, parse_toml, read_text
from twin.robot.paths import locate_file

REFERENCE_SHAPES = ("circle", "chirp", "joint_step")
"""Tables of [reference]; each one defines a whole reference."""
RETAINED_KEYS = {
    "body": (),
    "estimator": (),
    "controller": (
        "period_ms", "delay_ticks", "bus_delay_ticks", "speed_limit_rad_per_s", "gravity_compensation", "dead_zone_deg",
        "energy_tank", "model",
    ),
    "monitor": ("enabled", "period_ms"),
    "scale": ("period_ms",),
}  # fmt: skip
"""Roles of the robot that may be third-party, and the keys of their tables that still act then."""
ROBOT_TABLES = {"robot", "controller", "plant", "contact", "approach", "monitor"}
"""Tables that a robot's file may have; the last three only with values that follow from its lengths."""
FILE_KEYS = ("fmu", "python")
"""Keys with a file as value; for a class with its name after a colon."""
MAX_CHAIN_LENGTH = 32
"""Maximum number of files in a chain of `extends`, including the first."""
COMMAND_LINE = "set on the command line"
"""Origin of values set by an option."""
FMU_NAME_PREFIXES = ("parameters.", "wires.")
"""Last parts of table names whose keys are FMU names, `motor.R`; without quotes TOML makes tables of them."""


def refuse_other_files(values: Mapping[str, Any], path: Path) -> None:
    """Refuse a file whose values, merged with the files that it extends, are a robot, body, sweep or mapping."""
    tables, name = values.keys(), shlex.quote(str(path))
    reason = ""
    if is_robot(values):
        reason = f"a robot, not an experiment; twin init experiment.toml --robot {name} writes an experiment on it"
    elif tables == {"contact"}:
        reason = f"a body, not an experiment; press on it with: twin run pressing --body {name}"
    elif {"experiment", "vary"} & tables and "title" not in tables:
        reason = f"a sweep, not an experiment; run it with: twin sweep {name}"
    elif tables & {"fmu", "fmus"}:
        reason = f"the mapping of a drive, not an experiment; use it with: twin run fig4_force_position --drive {name}"
    if reason:
        raise InputRefused(f"{path}: {reason}")


def is_robot(values: Mapping[str, Any]) -> bool:
    """Whether merged values of files describe a robot, and not an experiment."""
    return "robot" in values and values.keys() <= ROBOT_TABLES


def names_drive(table: Mapping[str, Any]) -> bool:
    """Whether a [drive] table names a drive by an FMU file, rather than changing values of the drive already named."""
    parts = table.get("parts")
    named = parts.values() if isinstance(parts, Mapping) else ()
    return "fmu" in table or any(isinstance(part, Mapping) and "fmu" in part for part in named)


def _has_any_key(*keys: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda table: any(key in table for key in keys)


def names_stand_in(table: Mapping[str, Any]) -> bool:
    """Whether the table of a robot part, such as [controller], names a third-party file."""
    return any(key in table for key in FILE_KEYS)


class Replacement(NamedTuple):
    """Rule that a table replaces the same table of extended files as a whole instead of being merged.

    Attributes:
        names: whether a table's keys trigger the rule.
        retained: keys of the replaced table that stay; None if neither keys nor the table's position stay.
        by_key: whether a single key on the command line triggers the rule, too.
    """

    names: Callable[[Mapping[str, Any]], bool]
    retained: tuple[str, ...] | None
    by_key: bool = False


REPLACEMENT_RULES: dict[str, tuple[Replacement, ...]] = {
    "drive": (Replacement(names_drive, None),),
    # the height belongs to the robot that works there, not to the body
    "contact": (Replacement(_has_any_key("body"), ("height_mm",)),),
    # for waypoints, one file may give the times and another the positions
    "reference": (
        Replacement(_has_any_key(*REFERENCE_SHAPES), ()),
        Replacement(_has_any_key("t_s", "p_mm"), ("t_s", "p_mm")),
    ),
    **{role: (Replacement(names_stand_in, retained, by_key=True),) for role, retained in RETAINED_KEYS.items()},
}


def rules_for(name: str, table: Any, by_key: bool = False) -> list[Replacement]:
    """Return the replacement rules that a table of an experiment's file triggers."""
    rules = REPLACEMENT_RULES.get(name, ()) if isinstance(table, Mapping) else ()
    return [rule for rule in rules if rule.names(table) and (rule.by_key or not by_key)]


@dataclass
class Source:
    """Merged values of experiment files, before any check.

    Attributes:
        values: nested tables; arrays as tuples.
        origins: origin of each value by dotted key: its own `source`, or the file or option that set it.
        remarks: remarks on values that a run reports, such as the height of the surface.
    """

    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def overlay(self, tables: dict[str, Any], origin: str, by_key: bool = False) -> None:
        """Merge tables over the present values of the experiment, with their origin.

        A table that names another drive, body, shape or part replaces the present table. `by_key`: the tables are a key
        of the command line.
        """
        for name, table in tables.items():
            for rule in rules_for(name, table, by_key):
                # another drive has other parameters, so all previous ones are removed
                self.remove(name, rule.retained)
        self.merge(tables, origin)

    def select_file(self, table: str, key: str, value: str) -> None:
        """Replace a table of the experiment by a file given on the command line with `--drive` or `--body`."""
        (rule,) = rules_for(table, {key: value})
        self.remove(table, rule.retained)
        self.values[table] = {key: value, **self.values.get(table, {})}
        self.origins[f"{table}.{key}"] = COMMAND_LINE

    def remove(self, table: str, keep: Collection[str] | None = None) -> None:
        """Remove a table of the experiment, or all of its keys but `keep`."""
        before = self.values.pop(table, None)
        retained = {key: before[key] for key in before if key in (keep or ())} if isinstance(before, dict) else {}
        if keep is not None and isinstance(before, dict):
            self.values[table] = retained
        paths = {f"{table}.{key}" for key in retained}
        self.origins = {k: v for k, v in self.origins.items() if not k.startswith(f"{table}.") or k in paths}

    def merge(self, table: dict[str, Any], origin: str, prefix: str = "", into: dict[str, Any] | None = None) -> None:
        """Merge a table over the present values of the experiment key by key, with the origin of each value."""
        target = self.values if into is None else into
        for key, value in table.items():
            dotted = f"{prefix}{key}"
            if isinstance(value, dict) and "value" in value and value.keys() <= {"value", "source"}:
                target[key] = _freeze_lists(value["value"])
                self.origins[dotted] = str(value.get("source", origin))
            elif isinstance(value, dict) and isinstance(items := target.get(key), tuple):
                # items of an array are addressed by number from 1: tables are merged, numbers replaced
                if any(isinstance(item, dict) for item in items):
                    self._merge_items(value, origin, dotted, items)
                else:
                    target[key] = with_numbers(value, items, f"{origin}: {dotted}")
            elif isinstance(value, dict) and prefix.endswith(FMU_NAME_PREFIXES):
                self.merge({f"{key}.{name}": item for name, item in value.items()}, origin, prefix, target)
            elif isinstance(value, dict):
                inner = target.get(key)
                target[key] = inner if isinstance(inner, dict) else {}
                self.merge(value, origin, f"{dotted}.", target[key])
            elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
                # an array of tables is replaced as a whole: its items have no names to match them
                self.origins = {k: v for k, v in self.origins.items() if not k.startswith(f"{dotted}.")}
                target[key] = tuple({} for _ in value)
                numbered = {str(number): item for number, item in enumerate(value, start=1)}
                self._merge_items(numbered, origin, dotted, target[key])
            else:
                target[key] = _freeze_lists(value)
                self.origins[dotted] = origin

    def _merge_items(self, items: dict[str, Any], origin: str, dotted: str, into: tuple[Any, ...]) -> None:
        """Merge tables into numbered items of an array of tables; numbers start at 1."""
        for number, item in items.items():
            if not (number.isdigit() and 1 <= int(number) <= len(into) and isinstance(item, dict)):
                there = f"is only {dotted}.1" if len(into) == 1 else f"are tables {dotted}.1 to {dotted}.{len(into)}"
                raise InputRefused(f"{origin}: {dotted}.{number}: there {there}")
            self.merge(item, origin, f"{dotted}.{number}.", into[int(number) - 1])


def with_numbers(items: Mapping[str, Any], into: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    """Replace numbered elements of an array: key 2, as in `joint_zero_deg.2`, replaces the second element."""
    numbers = list(into)
    for number, item in items.items():
        if not (number.isdigit() and 1 <= int(number) <= len(into)):
            raise InputRefused(f"{where}.{number}: there are numbers {where.split()[-1]}.1 to .{len(into)}")
        numbers[int(number) - 1] = item
    return tuple(numbers)


def read_source(path: Path) -> Source:
    """Read an experiment's TOML file, merged over the files that it `extends`, without any check.

    Tables that replace others instead are listed in `REPLACEMENT_RULES`.

    Raises:
        InputRefused: the file is missing or not TOML, or `extends` is circular.
    """
    source = Source()
    for file, table in reversed(_chain(path)):
        source.overlay(table, f"set in {file.name}")
    return source


def apply_overrides(source: Source, texts: Iterable[str]) -> None:
    """Merge the settings of the command line, "table.key=value" each, over the experiment's values."""
    nodes = [_node(text) for text in texts]
    # settings that name a third-party part go first: they remove keys of twin's own part, but no other settings
    for node in sorted(nodes, key=lambda node: not any(rules_for(name, node[name], by_key=True) for name in node)):
        source.overlay(node, COMMAND_LINE, by_key=True)


def _node(text: str) -> dict[str, Any]:
    """Parse a command-line setting "table.key=value" into nested tables."""
    key, equals, value = text.partition("=")
    names = key_names(key.strip())
    if not equals or not key.strip() or len(names) > MAX_DEPTH:
        raise InputRefused(f"--set {text}: expected key=value, for example controller.force.reference_N=4")
    node: Any = value.strip()
    # a bare word is text, so that --set controller.mode=position needs no quotes inside quotes
    with contextlib.suppress(InputRefused):
        node = parse_toml(f"value = {node}", "")["value"]
    # text outside TOML files has plain digits; only quotes and inline tables contain other underscores
    if isinstance(node, int | float | list) and "_" in value and not re.search("[\"'{]", value):
        raise InputRefused(f"--set {text}: expected numbers without underscores")
    for name in reversed(names):
        node = {name: node}
    return node


def key_names(key: str) -> list[str]:
    """Split a dotted TOML key into names; a quoted name may contain dots: `a."b.c"`."""
    names: list[str] = []
    with contextlib.suppress(InputRefused):
        node: Any = parse_toml(f"{key} = 0", "")
        while isinstance(node, dict) and len(node) == 1:
            ((name, node),) = node.items()
            names.append(name)
        if node == 0:
            return names
    # not a TOML key: it is refused when the names are checked
    return key.split(".")


def merge_tables(base: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a deep copy of two nested tables, the second merged over the first key by key."""
    merged = copy.deepcopy(dict(base))
    for key, value in table.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merge_tables(merged[key], value) if both else copy.deepcopy(value)
    return merged


def value_at(tables: Mapping[str, Any], key: str) -> Any:
    """Return the value at a dotted key of nested tables; None if missing."""
    node: Any = tables
    for name in key.split("."):
        node = node.get(name) if isinstance(node, Mapping) else None
    return node


def _chain(path: Path) -> list[tuple[Path, dict[str, Any]]]:
    """Return (path, tables) of an experiment's file and of all files that it extends, in that order."""
    chain = [(path, _tables(path))]
    met = {os.path.realpath(path)}
    while (parent := chain[-1][1].pop("extends", None)) is not None:
        last = chain[-1][0]
        if not isinstance(parent, str):
            raise InputRefused(f"{last}: extends = {parent!r}: expected the name of a TOML file")
        following = locate_file(parent, Path(os.path.realpath(last)).parent)
        # read first: an invalid name has no real path either
        tables = _tables(following)
        if os.path.realpath(following) in met:
            raise InputRefused(f"{path}: its files extend each other in a circle; remove one 'extends'")
        if len(chain) == MAX_CHAIN_LENGTH:
            raise InputRefused(f"{path}: extends a chain of more than {MAX_CHAIN_LENGTH} files; merge some")
        met.add(os.path.realpath(following))
        chain.append((following, tables))
    return chain


def _tables(path: Path) -> dict[str, Any]:
    """Read the tables of one TOML file, without the files that it extends."""
    return dict(_parse_toml(read_text(path, MAX_TOML_BYTES, "experiment file"), str(path)))


@functools.lru_cache(maxsize=64)
def _parse_toml(text: str, where: str) -> Mapping[str, Any]:
    """Parse TOML text, cached as all runs of a sweep read the same files; the result must not be modified."""
    return parse_toml(text, where)


def _freeze_lists(value: Any) -> Any:
    return tuple(_freeze_lists(item) for item in value) if isinstance(value, list) else value


def toml_value(value: Any) -> str:
    """Format a value as TOML, tables inline."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {toml_value(item)}' for key, item in value.items())}}}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(toml_value, value))}]"
    # JSON formats numbers, booleans and strings as TOML does, except for DEL, which TOML requires to be escaped
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
