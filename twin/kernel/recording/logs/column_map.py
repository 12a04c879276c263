"""Grammar of column maps: columns of a foreign file -> signals.

A map is a TOML file, or texts on the command line, or both; later entries win:

    time = { column = "stamp", unit = "ms" }
    arm.force = { column = "Fz", unit = "N", sign = -1 }
    "arm.tip[2]" = "z_mm"

    time=stamp[ms]  arm.force=-Fz[N]  arm.tip[2]=z_mm

Left of `=` is the product's name (or `time`), right of it a column of a CSV file, or topic and field of an MCAP file
(`/wrench.force.z`, `/joints.position[2]`). Unit and sign belong to the column; without a unit, the column's name must
contain one. With a map, only the mapped signals are read.
"""

import difflib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import read_toml
from twin.kernel.recording.logs.log import LogError, MappedColumn
from twin.kernel.units import UNIT_SYMBOLS, Unit, known_unit, weight_hint

TIME_SIGNAL = "time"
TIME_NAMES = ("t", "time", "timestamp")
"""Names of the time column without a map, followed by a unit: `t_s`, `time [ms]`."""
_ENTRY_KEYS = {"column", "unit", "sign"}
_BRACKETED_UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]+)\]|\(([^()]+)\))\s*")
_MOTOR_SIDE = re.compile(r"(.*\.)?(theta|omega|count)_m")
"""Names whose m means the motor, not the metre."""


def column_map(entries: Sequence[str | Path]) -> dict[str, MappedColumn]:
    """Parse a column map from texts `NAME=[-]COLUMN[UNIT]` and TOML files into columns by signal (and `time`)."""
    columns: dict[str, MappedColumn] = {}
    mistakes: list[str] = []
    for entry in entries:
        name, equals, source = (text.strip() for text in str(entry).partition("="))
        if isinstance(entry, Path) or not equals:
            columns |= _read_map_file(Path(entry), mistakes)
        elif not name or not source.lstrip("-"):
            mistakes.append(f"--map {entry}: expected NAME=COLUMN, NAME=COLUMN[UNIT] or a TOML file")
        else:
            columns[name] = _parse_column(source)
    if mistakes:
        raise LogError("\n".join(mistakes))
    return columns


def split_unit(header: str) -> tuple[str, str]:
    """Split a column's name into name and unit; the unit is empty for a name without a unit.

    `F [N]` and `F (N)` may have any unit; `F_N` and `speed_rad_per_s` one word, N_m, or words with _per_.
    """
    bracketed = _BRACKETED_UNIT.fullmatch(header)
    # digits in brackets are an index
    if bracketed and not (bracketed[2] or "").isdigit():
        return bracketed[1], bracketed[2] or bracketed[3]
    words = header.split("_")
    start = len(words) - (3 if len(words) > 3 and words[-2] == "per" else 1)
    # `twin export` writes the newton metre as two words
    if words[start - 1 : start + 1] == ["N", "m"]:
        start -= 1
    name, text = "_".join(words[:start]), "_".join(words[start:])
    if name and known_unit(text) and not _MOTOR_SIDE.fullmatch(header):
        return name, text
    return header, ""


def require_unit(text: str, where: str) -> Unit:
    """Parse a column's unit: `mm`, `rad/s`, `deg_per_s`; for an unknown one, LogError names `where` and the nearest."""
    found = known_unit(text)
    if found is None:
        hint = nearest(text, UNIT_SYMBOLS, "expected one such as mm, N, deg, rad/s, Nm, ms, A or 1")
        raise LogError(f"{where}: unknown unit '{text}'; {hint}")
    return found


def refuse_unit(where: str, name: str, got: str, wanted: str, column: str = "COLUMN") -> None:
    """Reject, with the entry to write in the map for `column`, a signal whose SI unit differs from the wanted one."""
    if got != wanted:
        found, used = known_unit(got), known_unit(wanted)
        hint = weight_hint(found.dimension, used.dimension) if found and used else ""
        raise LogError(
            f"{where} {name} is in '{got}', expected '{wanted}'{hint or ';'} "
            f"declare its unit with --map {name}={column}[UNIT]"
        )


def map_text(signal: str, column: MappedColumn) -> str:
    """Format the line of a map file for a signal: `"arm.force" = "-Fz[N]"`."""
    text = f"{'-' if column.sign < 0 else ''}{column.name}{f'[{column.unit}]' if column.unit else ''}"
    return f"{json.dumps(signal)} = {json.dumps(text, ensure_ascii=False)}"


def _parse_column(source: str) -> MappedColumn:
    """Parse a column text `-Fz[N]` into name Fz, unit N and sign -1; an index is part of the name."""
    sign, text = (-1 if source.startswith("-") else 1), source
    source = source.removeprefix("-")
    match = re.fullmatch(r"(.+)\[([^\[\]]+)\]", source)
    if match and not match[2].isdigit():
        return MappedColumn(match[1].strip(), match[2], sign, text)
    return MappedColumn(source, "", sign, text)


def _read_map_file(path: Path, mistakes: list[str]) -> dict[str, MappedColumn]:
    try:
        content = read_toml(path)
    except InputRefused as problem:
        mistakes.append(f"{problem}; expected NAME=COLUMN or a TOML file")
        return {}
    columns: dict[str, MappedColumn] = {}
    if not content:
        mistakes.append(f'{path}: an empty map; expected NAME = "COLUMN"')
    _collect_entries(path, "", content, columns, mistakes)
    return columns


def _collect_entries(
    path: Path, prefix: str, table: dict[str, Any], columns: dict[str, MappedColumn], mistakes: list[str]
) -> None:
    """Collect the entries of a column map's TOML `table`; unquoted dots in names are nested tables."""
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, str) and value.lstrip("-"):
            columns[name] = _parse_column(value)
        elif not isinstance(value, dict) or not value:
            mistakes.append(f'{path}: {name} = {value!r}: expected "COLUMN" or {{ column = "COLUMN", unit = "N" }}')
        elif not any(difflib.get_close_matches(word, _ENTRY_KEYS, 1, cutoff=0.8) for word in value):
            _collect_entries(path, f"{name}.", value, columns, mistakes)
        elif unknown := sorted(set(value) - _ENTRY_KEYS):
            mistakes.append(f"{path}: {name}: unknown key '{unknown[0]}'; known are column, unit, sign")
        else:
            column, unit, sign = value.get("column"), value.get("unit", ""), value.get("sign", 1)
            if not isinstance(column, str) or not column:
                mistakes.append(f'{path}: {name}: expected column = "COLUMN"')
            elif not isinstance(unit, str):
                mistakes.append(f"{path}: {name}: unit = {unit!r}: expected text in quotes")
            elif sign not in (1, -1) or isinstance(sign, bool):
                mistakes.append(f"{path}: {name}: sign = {sign!r}: expected 1 or -1")
            else:
                columns[name] = MappedColumn(column, unit, sign)
