"""Proposed column map for a robot's CSV file, from names, units and values of its columns.

Unambiguous entries are written as such, ambiguous ones as comments.
"""

import json
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twin.kernel.atomic_write import write_text
from twin.kernel.errors import escape_controls
from twin.kernel.recording.logs.column_map import TIME_NAMES, TIME_SIGNAL, split_unit
from twin.kernel.recording.logs.csv_file import TIME_DIMENSION
from twin.kernel.recording.logs.csv_table import CsvTable, read_table
from twin.kernel.recording.logs.log import LogError
from twin.kernel.units import FORCE, Dimension, known_unit

ANGLE_DIMENSION, MASS_DIMENSION = Dimension(rad=1), Dimension(kg=1)
SIDE_WORDS = {"m": ("m", "mot", "motor", "motors"), "l": ("l", "link", "joint", "load", "arm", "out", "output")}
"""Side of the spring, as in `theta_m` and `theta_l` -> words in column names."""
FORCE_WORDS = ("f", "fz", "force", "scale", "load", "loadcell", "weight")
CLOCK_WORDS = (*TIME_NAMES, "stamp", "clock")
FORCE_NAME = "F_z"


class Triple(NamedTuple):
    """Three columns of one quantity, one per joint, whose names differ in a number, 0 to 2 or 1 to 3.

    Attributes:
        columns: column by joint.
        words: words of the common name, lower case.
        unit: unit in the names; "" without one.
        counts: whether all values are integers without a unit.
    """

    columns: Sequence[str]
    words: frozenset[str]
    unit: str
    counts: bool


def propose(log: Path) -> tuple[Path, bool]:
    """Propose a column map for a robot's CSV file, and write it as NAME.map.toml in the same folder.

    Return the path of the map, and whether it is complete.
    """
    text, complete = proposal(read_table(log))
    path = log.with_suffix(".map.toml")
    if os.path.lexists(path):
        raise LogError(f"{path}: is there already and is not touched; remove or rename it for a new one")
    write_text(path, text)
    return path, complete


def proposal(table: CsvTable) -> tuple[str, bool]:
    """Create the text of a column map for a CSV table. Return it, and whether it is unambiguous."""
    numbers = [name for name in table.head if table.head.count(name) == 1 and table.is_numbers(name)]
    sections = [_time(table, numbers), *_angles(table, numbers), _force(table, numbers)]
    taken = {name for lines in sections for name in numbers if any(_toml_string(name) in line for line in lines)}
    lines = [
        f"# Which column of {escape_controls(table.path.name)} is which signal, for twin replay and twin identify.",
        "# Angles: positive where the link goes down, zero with it horizontal; the motor's before the belt.",
    ]
    for section in sections:
        lines += ["", *section]
    if left := [name for name in table.head if name not in taken]:
        lines += ["", f"# not used: {', '.join(map(escape_controls, left))}"]
    return "\n".join(lines) + "\n", not any(line.startswith("#") and " = " in line for line in lines)


def _time(table: CsvTable, numbers: Sequence[str]) -> list[str]:
    """Propose map entries for the time: ascending columns in a unit of time, or with a usual name."""
    rising = [name for name in numbers if np.all(np.diff(table.column(name)) > 0.0)]
    units = {name: known_unit(split_unit(name)[1]) for name in rising}
    timed = [name for name in rising if (found := units[name]) is not None and found.dimension == TIME_DIMENSION]
    named = [name for name in rising if _words(name) & set(CLOCK_WORDS)]
    if len(timed) == 1:
        return [_line(TIME_SIGNAL, timed[0])]
    offered = timed or named
    if not offered:
        return [f'# {TIME_SIGNAL} = {{ column = "?", unit = "s" }}   # no column that ascends is called a time']
    unit = "" if timed else "s"
    return [f"# {_line(TIME_SIGNAL, name, unit)}{'' if timed else '   # in which unit?'}" for name in offered]


def _angles(table: CsvTable, numbers: Sequence[str]) -> Iterator[list[str]]:
    triples = [one for one in triples_of(table, numbers) if one.counts or _dimension(one.unit) == ANGLE_DIMENSION]
    found = {side: [one for one in triples if one.words & set(words)] for side, words in SIDE_WORDS.items()}
    # if one of two triples is known, the other follows
    for side, other in (("m", "l"), ("l", "m")):
        if not found[side] and len(found[other]) == 1 and len(triples) == 2:
            found[side] = [one for one in triples if one not in found[other]]
    for side in SIDE_WORDS:
        sure = len(found[side]) == 1
        offered = found[side] or triples
        lines = []
        for one in offered:
            signal = f"encoder.count_{side}" if one.counts else f"estimator.theta_{side}"
            lines += [_line(f"{signal}[{joint}]", column) for joint, column in enumerate(one.columns)]
        no_line = f'"estimator.theta_{side}[0]" = {{ column = "?", unit = "deg" }}'
        lines = lines or [f"{no_line}   # no three columns are angles or counts; 1 and 2, too"]
        yield [f"{'' if sure else '# '}{line}" for line in lines]


def _force(table: CsvTable, numbers: Sequence[str]) -> list[str]:
    units = {name: split_unit(name)[1] for name in numbers}
    forces = [name for name in numbers if _dimension(units[name]) == FORCE]
    weights = [name for name in numbers if _dimension(units[name]) == MASS_DIMENSION]
    if len(forces) + len(weights) == 1:
        (name,) = [*forces, *weights]
        # a scale's grams are a weight
        unit = units[name] if forces else f"{units[name]}f"
        values = table.column(name)
        sign = -1 if abs(float(np.nanmin(values))) > abs(float(np.nanmax(values))) else 1
        return [_line(f"scale.{FORCE_NAME}", name, unit, sign)]
    offered = [*forces, *weights] or [name for name in numbers if not units[name] and _words(name) & set(FORCE_WORDS)]
    if not offered:
        return [f"# No column is a force: twin replay can still compare with --plant. scale.{FORCE_NAME} has none."]
    return [
        f"# {_line(f'scale.{FORCE_NAME}', name, '' if name in forces else f'{units[name]}f' if units[name] else 'N')}"
        f"{'' if units[name] else '   # in which unit?'}"
        for name in offered
    ]


def triples_of(table: CsvTable, numbers: Sequence[str]) -> list[Triple]:
    """Find sets of three columns whose names differ in the joint's number, in the order of the file."""
    stems: dict[tuple[str, str], dict[int, str]] = {}
    for column in numbers:
        name, unit = split_unit(column)
        if match := re.fullmatch(r"(.*?)(\d+)(\D*)", name):
            stems.setdefault((f"{match[1]}#{match[3]}", unit), {})[int(match[2])] = column
    found = []
    for (stem, unit), numbered in stems.items():
        if sorted(numbered) in ([0, 1, 2], [1, 2, 3]):
            three = [numbered[joint] for joint in sorted(numbered)]
            values = [table.column(name) for name in three]
            whole = all(np.array_equal(one, np.rint(one), equal_nan=True) for one in values)
            found.append(Triple(three, _words(stem), unit, whole and unit in ("", "1")))
    return found


def _words(name: str) -> frozenset[str]:
    """Split a column's name into words: `q_motor[1]` and `qMotor1` have q and motor."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", split_unit(name)[0])
    return frozenset(word.lower() for word in re.findall(r"[A-Za-z]+", apart))


def _dimension(unit: str) -> Dimension | None:
    found = known_unit(unit)
    return found.dimension if found and unit else None


def _line(signal: str, column: str, unit: str = "", sign: int = 1) -> str:
    """Format an entry of a column map; `unit` is "" if the column's name contains it."""
    name = signal if signal == TIME_SIGNAL else json.dumps(signal)
    unit = unit or split_unit(column)[1]
    rest = (f", unit = {json.dumps(unit)}" if unit else "") + (", sign = -1" if sign < 0 else "")
    return f"{name} = {{ column = {_toml_string(column)}{rest} }}"


def _toml_string(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)
