"""Input signals of a system: expressions, files, and the tables of an SSP archive (CSV components)."""

import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twin.kernel.archive import sha256
from twin.kernel.cosim.expression import parse_expression
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.source import Between, SampledSignal, Signal, source
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.variable import MAX_EXACT, Variable
from twin.kernel.recording.logs.column_map import TIME_NAMES, require_unit, split_unit
from twin.kernel.recording.logs.csv_table import CsvTable, parse_table, read_table
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.flat import FlatSystem, UnitStep
from twin.kernel.ssp.package import Package
from twin.kernel.systems.additions import UNIT_PATTERN, SystemNames
from twin.kernel.systems.extras import Feed, SystemExtras
from twin.kernel.systems.naming import identifier, topic_name, unique_names

INPUTS_TOPIC = "inputs"
"""Component and topic name of the user's input signals."""
SIGNAL_SUFFIXES = (".csv", ".mcap")


@dataclass(frozen=True)
class _InputSignal:
    """A signal over time and the system input that it feeds; `about` is its expression, or file name and digest.

    `unit` is of its values; "" for the unit of the input.
    """

    name: str
    place: ssp.Endpoint
    signal: Signal
    unit: str
    about: str
    ignored: tuple[str, ...] = ()


def input_extras(names: SystemNames, inputs: Sequence[str], settings: Sequence[str]) -> SystemExtras:
    """Make a component of the signals that feed inputs (see `Additions`; no input in both), and its connections."""
    fed = [one for text in inputs for one in _input_signals(names, text)]
    if not fed:
        return SystemExtras()
    set_ = {names.place(text.partition("=")[0].strip(), "--set") for text in settings}
    ports, signals, feeds, about, spans = [], [], [], {}, {}
    for one, port in zip(fed, unique_names(identifier(one.name) for one in fed), strict=True):
        if one.place in set_:
            raise InputRefused(f"--input {one.name} and --set {one.name} contradict each other; remove one")
        by, wire = f"--input {one.name}", f"{INPUTS_TOPIC}.{port}"
        ends: Sequence[tuple[ssp.Endpoint, tuple[UnitStep, ...]]] = [(one.place, ())]
        spelled = one.unit
        if not one.place.element:
            ends = names.flat.entrances[one.place.connector]
            spelled = spelled or names.package.structure.system.connector_of[one.place.connector].unit
        else:
            spelled = spelled or names.variable(one.place).unit
        feeds += [Feed(end, wire, by, one.unit if not hops else spelled, hops) for end, hops in ends]
        ports.append(Port(port, 1, spelled or "1", f"{one.name}, by {one.about}"))
        signals.append(one.signal)
        about[one.name] = one.about
        if isinstance(one.signal, SampledSignal):
            spans[one.name] = (float(one.signal.t[0]), float(one.signal.t[-1]))
    ignored = tuple(dict.fromkeys(name for one in fed for name in one.ignored))
    fed_by = source(INPUTS_TOPIC, ports, signals)
    return SystemExtras((fed_by,), tuple(feeds), signals=(INPUTS_TOPIC,), about=about, ignored=ignored, spans=spans)


def _input_signals(names: SystemNames, text: str) -> Iterator[_InputSignal]:
    name, equals, given = (part.strip() for part in text.partition("="))
    if not equals:
        yield from _file_signals(names, Path(text.strip()))
        return
    if not name or not given:
        raise InputRefused(f"--input {text}: expected NAME=SOURCE, such as u=step(1.0), or a CSV file")
    place, where = _input(names, name), f"--input {name}"
    file, _, column = given.partition(":")
    # unlike Path.exists, os.path.exists does not raise for an expression that is too long for a name
    if Path(file).suffix.lower() in SIGNAL_SUFFIXES or os.path.exists(file):
        spelled = ""
        if column and (measured := UNIT_PATTERN.fullmatch(column)) and not measured["unit"].isdigit():
            column, spelled = measured["value"], measured["unit"]
        held = _is_held(names, place)
        samples, own = _series(Path(file), column, name, where, held)
        _refuse_broken(names, place, samples, f"{where}: {file}")
        yield _InputSignal(name, place, samples, spelled or own, f"{Path(file).name} sha256 {_sha256(Path(file))[:12]}")
    else:
        signal = parse_expression(given, where)
        for variable in _fed_variables(names, place):
            if variable.type not in ssp.REAL_TYPES and np.any(np.abs(signal.numbers) >= MAX_EXACT):
                raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected numbers below 2^53")
        yield _InputSignal(name, place, signal, "", given)


def _file_signals(names: SystemNames, file: Path) -> Iterator[_InputSignal]:
    """Yield an input signal for every column of `file` that has the name of a system input."""
    if file.suffix.lower() not in SIGNAL_SUFFIXES and not os.path.exists(file):
        raise InputRefused(f"--input {file}: expected NAME=SOURCE, such as u=step(1.0), or a CSV file")
    known, table = dict(names.inputs()), read_table(file)
    time = _time(table)
    columns = [head for head in table.head if head != time[0]]
    names_of = {head: (head, "") if head in known else _split_brackets(head) for head in columns}
    others = tuple(head for head in columns if names_of[head][0] not in known)
    if len(others) == len(columns):
        raise InputRefused(
            f"--input {file}: no input is called {', '.join(others)}; {nearest(others[0], known)} Or name the column: "
            "--input NAME=FILE:COLUMN"
        )
    for head in (head for head in columns if head not in others):
        name, spelled = names_of[head]
        samples = SampledSignal(time[1], _column(table, head), "held" if _is_held(names, known[name]) else "lines")
        _refuse_broken(names, known[name], samples, f"{file}: column '{head}'")
        about = f"{file.name} sha256 {_sha256(file)[:12]}"
        yield _InputSignal(name, known[name], samples, spelled, about, tuple(f"{file.name}: {one}" for one in others))


def _input(names: SystemNames, name: str) -> ssp.Endpoint:
    place = names.place(name, "--input")
    if not place.element and place.connector not in names.flat.entrances:
        raise InputRefused(f"--input {name}: it is not an input of the system")
    if place.element and names.variable(place).causality != "input":
        raise InputRefused(f"--input {name}: it is {names.variable(place).causality}; expected an input")
    return place


def _fed_variables(names: SystemNames, place: ssp.Endpoint) -> list[Variable]:
    ends = [place] if place.element else [end for end, _ in names.flat.entrances[place.connector]]
    return [names.variable(end) for end in ends]


def _is_held(names: SystemNames, place: ssp.Endpoint) -> bool:
    """Whether an input signal's samples are held, not interpolated: true if any input is not a continuous real."""
    return any(v.variability != "continuous" or v.type not in ssp.REAL_TYPES for v in _fed_variables(names, place))


def _refuse_broken(names: SystemNames, place: ssp.Endpoint, samples: SampledSignal, where: str) -> None:
    for variable in _fed_variables(names, place):
        if variable.type not in ssp.REAL_TYPES and not np.all(samples.values == np.rint(samples.values)):
            bad = samples.values[samples.values != np.rint(samples.values)][0]
            raise InputRefused(
                f"{where}: {bad:g} for {variable.name}, which is {variable.type}; expected whole numbers"
            )
        found = np.unique(samples.values) if variable.items else (np.nanmin(samples.values), np.nanmax(samples.values))
        for value in map(float, found):
            # a larger integer may have been rounded to MAX_EXACT when it was read
            rounded = abs(value) == MAX_EXACT and variable.type not in ssp.REAL_TYPES
            if why := variable.range_error(2.0 * value if rounded else value):
                raise InputRefused(f"{where}: {why}")


def _series(file: Path, column: str, name: str, where: str, held: bool) -> tuple[SampledSignal, str]:
    """Return (samples, unit) of a signal: a column of a CSV file or a series of a recording."""
    between: Between = "held" if held else "lines"
    if file.suffix.lower() != ".csv":
        log = read_log(file)
        wanted = column or name
        if wanted not in log.series:
            raise InputRefused(
                f"{where}: {file}: '{wanted}' is not there; {nearest(wanted, log.series, 'it has {}', 3)}"
            )
        series = log[wanted]
        return SampledSignal(series.t, series.values, between), "" if series.unit == "1" else series.unit  # type: ignore[arg-type]
    table = read_table(file)
    time, t = _time(table)
    heads = [head for head in table.head if head != time]
    wanted = column or next((head for head in heads if name in (head, _split_brackets(head)[0])), "")
    if not wanted and len(heads) == 1:
        wanted = heads[0]
    if wanted not in heads:
        wanted = next((head for head in heads if _split_brackets(head)[0] == (wanted or name)), wanted)
    if wanted not in heads:
        hint = nearest(column or name, heads, "it has {}")
        raise InputRefused(f"{where}: {file} has no column '{column or name}'; {hint}")
    return SampledSignal(t, _column(table, wanted), between), _split_brackets(wanted)[1]  # type: ignore[arg-type]


def _split_brackets(head: str) -> tuple[str, str]:
    """Split a CSV column head `u [rpm]` into name and unit; a unit without brackets may be part of the name."""
    return split_unit(head) if head.rstrip().endswith(("]", ")")) else (head, "")


def _time(table: CsvTable) -> tuple[str, np.ndarray]:
    named = {head: split_unit(head) for head in table.head}
    head = next((head for head, (name, _) in named.items() if name.lower() in TIME_NAMES), None)
    if head is None:
        raise LogError(f"{table.path}: no column of time; it has {', '.join(table.head)}; call it time, in s")
    t = _column(table, head)
    if named[head][1]:
        t = require_unit(named[head][1], f"{table.path}: column '{head}'").in_si(t)
    back = np.flatnonzero(np.diff(t) < 0.0) + 1
    if len(back):
        k = int(back[0])
        raise LogError(f"{table.path} line {table.lines[k]}: time runs backwards from {t[k - 1]:g} s to {t[k]:g} s")
    return head, t


def _column(table: CsvTable, head: str) -> np.ndarray:
    wrong = table.wrong_fields(head)
    if wrong:
        got = f"'{wrong.text}'" if wrong.text else "nothing"
        raise LogError(f"{table.path} line {wrong.line}: column '{head}' holds {got}; expected a finite number")
    return table.column(head)


def _sha256(file: Path) -> str:
    return sha256(file) if file.is_file() else "of a folder"


def table_extras(package: Package, flat: FlatSystem) -> tuple[FlatSystem, SystemExtras]:
    """Replace components that are tables over time; return (system without them, signal components and wires)."""
    tables = {
        path: one
        for path, one in flat.components.items()
        if one.type == ssp.TABLE_TYPE or (one.type == "" and one.source.lower().endswith(".csv"))
    }
    if not tables:
        return flat, SystemExtras()
    components, feeds, about = [], [], {}
    for path, component in tables.items():
        where = f"{package.file}: component '{path}'"
        entry = package.entry(component.source)
        if not entry or not entry.lower().endswith(".csv"):
            raise InputRefused(f"{where}: its table '{component.source}' is not a CSV file of this archive")
        content = package.content(entry)
        table = parse_table(Path(f"{package.file}: {entry}"), io.BytesIO(content))
        time, t = _time(table)
        used = list(dict.fromkeys(lead.start.connector for lead in flat.leads if lead.start.element == path))
        ports, signals = [], []
        for name, port in zip(used, unique_names(identifier(name) for name in used), strict=True):
            if name not in table.head or name == time:
                raise InputRefused(f"{where}: {entry} has no column '{name}'; {nearest(name, table.head, 'it has {}')}")
            stated = component.connector_of.get(name)
            held = stated is not None and stated.type not in ("", *ssp.REAL_TYPES)
            ports.append(Port(port, 1, (stated.unit if stated else "") or "1", f"column {name} of {entry}"))
            signals.append(SampledSignal(t, _column(table, name), "held" if held else "lines"))
            for lead in flat.leads:
                if lead.start == ssp.Endpoint(path, name):
                    spelled = stated.unit if stated else ""
                    by = f"{package.file}: the connection from {'.'.join(lead.start)} to {'.'.join(lead.end)}"
                    feeds.append(Feed(lead.end, f"{topic_name(path)}.{port}", by, spelled, lead.hops))
        if used:
            components.append(source(topic_name(path), ports, signals))
        about[path] = entry
    rest = {path: one for path, one in flat.components.items() if path not in tables}
    leads = tuple(lead for lead in flat.leads if lead.start.element not in tables)
    found = SystemExtras(tuple(components), tuple(feeds), signals=tuple(one.name for one in components), about=about)
    return replace(flat, components=rest, leads=leads), found
