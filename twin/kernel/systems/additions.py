"""What a user adds to a system on the command line: values (`--set`, `--ssv`) and inputs over time (`--input`).

Tables in an SSP archive (OMSimulator's CSV components) are the same as inputs over time that are wired.
"""

import io
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from twin.kernel.archive import sha256
from twin.kernel.cosim.expression import expression
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.source import Between, SampledSignal, Signal, source
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import read_bytes
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.variable import EXACT, Value, Variable
from twin.kernel.recording.logs.column_map import TIME_NAMES, split_unit, unit
from twin.kernel.recording.logs.csv_table import CsvTable, read_table, table_of
from twin.kernel.recording.logs.log import LogRefused
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.ssp.flat import Assigned, FlatSystem, Hop
from twin.kernel.ssp.package import Package
from twin.kernel.ssp.ssd import parameter_set
from twin.kernel.ssp.structure import (
    REALS,
    TABLE,
    TRUTH,
    WHOLES,
    Endpoint,
    ParameterBinding,
    ParameterSet,
    ParameterValue,
    SspComponent,
)
from twin.kernel.systems.beside import Beside, Feed
from twin.kernel.systems.naming import SINGLE, distinct, topic, word

INPUTS = "inputs"
"""The component, and topic, of signals that a user feeds in."""
FILES = (".csv", ".mcap")
_UNIT = re.compile(r"(?P<value>.*\S)\s*\[(?P<unit>[^\[\]]*)\]")
_LIST = re.compile(r"\[(?P<values>.*)\]")


@dataclass(frozen=True)
class Additions:
    """As the command line says it.

    Attributes:
        settings: texts NAME=VALUE.
        parameters: SSV files; a later one wins, and settings over all of them.
        inputs: texts NAME=SOURCE, or files whose columns are called as inputs are.
        recorded: patterns of what is recorded; none: all outputs.
    """

    settings: Sequence[str] = ()
    parameters: Sequence[Path] = ()
    inputs: Sequence[str] = ()
    recorded: Sequence[str] = ()


def given_text(value: Value) -> str:
    """A value as `--set` says it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence | np.ndarray):
        return f"[{', '.join(given_text(one) for one in value)}]"
    return str(value) if isinstance(value, int | np.integer) else repr(float(value))


def with_parameters(package: Package, files: Sequence[Path]) -> Package:
    """`package` whose outermost system has the values of SSV files, too.

    Raises:
        InputRefused: a file that is no SSV.
    """
    if not files:
        return package
    sets = [parameter_set(read_bytes(file, kind="SSV file"), str(file), str(file)) for file in files]
    if package.form == SINGLE:
        # what goes to one FMU may be called as its variables are
        component = package.structure.system.elements[0].name
        sets = [
            replace(one, parameters=tuple(_of_component(value, component) for value in one.parameters)) for one in sets
        ]
    return _bound(package, sets)


def _of_component(value: ParameterValue, component: str) -> ParameterValue:
    return value if value.name.startswith(f"{component}.") else replace(value, name=f"{component}.{value.name}")


def _bound(package: Package, sets: Iterable[ParameterSet]) -> Package:
    system = package.structure.system
    bindings = (*system.bindings, *(ParameterBinding(one) for one in sets))
    return replace(package, structure=replace(package.structure, system=replace(system, bindings=bindings)))


class SystemNames:
    """What names in a system mean.

    Args:
        package: of the system.
        flat: the same.
        files: of the FMUs, by component.
    """

    def __init__(self, package: Package, flat: FlatSystem, files: Mapping[str, Path]):
        self.package, self.flat = package, flat
        self.alone = next(iter(files)) if package.form == SINGLE else ""
        self._files = files

    def description(self, path: str) -> FmuDescription:
        # the plan looks whether it may need its authoring tool
        return described(self._files[path], lenient=True)

    def place(self, name: str, option: str) -> Endpoint:
        """The component and the variable that `name` means; no component: a connector of the outermost system.

        Raises:
            InputRefused: there is none.
        """
        if name in self.package.structure.system.connector_of:
            return Endpoint("", name)
        owners = [path for path in self._files if name.startswith(f"{path}.")]
        path = max(owners, key=len, default=self.alone)
        variable = name.removeprefix(f"{path}.")
        if path and variable in self.description(path).variables:
            return Endpoint(path, variable)
        where = f"{option} {name}: {self.package.file.name}"
        if path:
            raise InputRefused(f"{where}: {path} has no variable '{variable}'; {self._hint(variable, path)}")
        raise InputRefused(f"{where} has no component of this name; {nearest(name.partition('.')[0], self._files)}")

    def variable(self, end: Endpoint) -> Variable:
        return self.description(end.element).variables[end.connector]

    def inputs(self) -> Iterator[tuple[str, Endpoint]]:
        """What may be fed by the name of a column."""
        for name in self.flat.entrances:
            yield name, Endpoint("", name)
        for path in self._files:
            for variable in self.description(path).offered("input"):
                yield f"{path}.{variable.name}", Endpoint(path, variable.name)
                if self.alone:
                    yield variable.name, Endpoint(path, variable.name)

    def _hint(self, variable: str, path: str) -> str:
        description = self.description(path)
        known = [v.name for v in (*description.parameters, *description.offered("input"))]
        return nearest(variable, known, "it can be set: {}" if len(known) < 20 else "see twin drive info for its names")


def with_settings(flat: FlatSystem, names: SystemNames, settings: Sequence[str]) -> FlatSystem:
    """`flat` with the values of `settings`, which win over all others.

    Raises:
        InputRefused: no NAME=VALUE, a name that means nothing, a value of another type.
    """
    assigned = {path: dict(values) for path, values in flat.assigned.items()}
    seen: dict[Endpoint, str] = {}
    for text in settings:
        name, equals, given = (part.strip() for part in text.partition("="))
        if not equals or not name or not given:
            raise InputRefused(f"--set {text}: expected NAME=VALUE, such as Gain1.k=2")
        place = names.place(name, "--set")
        if place in seen:
            raise InputRefused(f"--set {name} is given twice, {seen[place]} and {given}; remove one")
        seen[place] = given
        if place.element:
            value = _value(place.connector, given, names.variable(place), f"--set {name}={given}")
            assigned.setdefault(place.element, {})[place.connector] = Assigned(value, (), ())
            continue
        if place.connector not in flat.entrances:
            raise InputRefused(f"--set {name}: it is no input of the system; set the component's variable")
        for end, hops in flat.entrances[place.connector]:
            value = _value(end.connector, given, names.variable(end), f"--set {name}={given}")
            assigned.setdefault(end.element, {})[end.connector] = Assigned(value, (), hops)
    return replace(flat, assigned=assigned)


def overruled(flat: FlatSystem, names: SystemNames, additions: Additions) -> Iterator[str]:
    """What `--set` and `--ssv` give to inputs that connections feed."""
    fed = {lead.end for lead in flat.leads}
    yield from (one for one in additions.settings if names.place(one.partition("=")[0].strip(), "--set") in fed)
    by_name = {".".join(end) for end in fed}
    # they were put behind those of the file
    sets = names.package.structure.system.bindings[-len(additions.parameters) :] if additions.parameters else ()
    yield from (one.name for by in sets for one in by.parameters.parameters if one.name in by_name)


def _value(name: str, text: str, variable: Variable, where: str) -> ParameterValue:
    """The value that `text` says, of the type of `variable`."""
    if variable.is_text:
        if variable.type != "String":
            raise InputRefused(f"{where}: {name} is binary, which cannot be set here")
        return ParameterValue(name, "String", (text.strip("'\""),))
    found, spelled = _LIST.fullmatch(text), ""
    if found is None and (measured := _UNIT.fullmatch(text)):
        text, spelled = measured["value"], measured["unit"]
    texts = [one.strip() for one in found["values"].split(",")] if found else [text]
    if variable.items and not found and _number(text) is None:
        # by its name, which the FMU's enumeration knows
        return ParameterValue(name, "Enumeration", (text,))
    numbers = tuple(_typed(one, variable, where) for one in texts)
    return ParameterValue(name, variable.type if variable.type in (*REALS, *WHOLES) else "Real", numbers, spelled)


def _typed(text: str, variable: Variable, where: str) -> float:
    if variable.type == "Boolean":
        if text.lower() not in TRUTH:
            raise InputRefused(f"{where}: {variable.name} is Boolean; expected true or false")
        return float(TRUTH[text.lower()])
    number = _number(text)
    if number is None:
        raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected a finite number")
    if variable.type not in REALS and not number.is_integer():
        raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected a whole number")
    # a number beyond what a double holds exactly is refused as it was given
    if variable.type not in REALS and (why := variable.unfit(int(Decimal(text)) if abs(number) >= EXACT else number)):
        raise InputRefused(f"{where}: {why}")
    return number


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class _Fed:
    """What is fed where: `unit` of the values ("": as of what they feed), `about` what they are made of."""

    name: str
    place: Endpoint
    signal: Signal
    unit: str
    about: str
    ignored: tuple[str, ...] = ()


def inputs_beside(names: SystemNames, inputs: Sequence[str], settings: Sequence[str], start: float = 0.0) -> Beside:
    """The signals of `inputs`, and what they feed.

    Args:
        names: of the system.
        inputs: see `Additions`.
        settings: likewise; what they set is not fed.
        start: when the run begins (s).

    Raises:
        InputRefused: a name that means no input, a file or an expression that cannot be read, an input that is given
            a value and a signal.
    """
    fed = [one for text in inputs for one in _fed(names, text)]
    if not fed:
        return Beside()
    set_ = {names.place(text.partition("=")[0].strip(), "--set") for text in settings}
    ports, signals, feeds, about, spans = [], [], [], {}, {}
    for one, port in zip(fed, distinct(word(one.name) for one in fed), strict=True):
        if one.place in set_:
            raise InputRefused(f"--input {one.name} and --set {one.name} contradict each other; remove one")
        by, wire = f"--input {one.name}", f"{INPUTS}.{port}"
        ends: Sequence[tuple[Endpoint, tuple[Hop, ...]]] = [(one.place, ())]
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
    fed_by = source(INPUTS, ports, signals, start)
    return Beside((fed_by,), tuple(feeds), signals=(INPUTS,), about=about, ignored=ignored, spans=spans)


def _fed(names: SystemNames, text: str) -> Iterator[_Fed]:
    name, equals, given = (part.strip() for part in text.partition("="))
    if not equals:
        yield from _by_name(names, Path(text.strip()))
        return
    if not name or not given:
        raise InputRefused(f"--input {text}: expected NAME=SOURCE, such as u=step(1.0), or a CSV file")
    place, where = _input(names, name), f"--input {name}"
    file, _, column = given.partition(":")
    # not Path.exists, which raises for a name that is too long, as of an expression
    if Path(file).suffix.lower() in FILES or os.path.exists(file):
        spelled = ""
        if column and (measured := _UNIT.fullmatch(column)) and not measured["unit"].isdigit():
            column, spelled = measured["value"], measured["unit"]
        held = _is_held(names, place)
        samples, own = _series(Path(file), column, name, where, held)
        _refuse_broken(names, place, samples, f"{where}: {file}")
        yield _Fed(name, place, samples, spelled or own, f"{Path(file).name} sha256 {_sha256(Path(file))[:12]}")
    else:
        signal = expression(given, where)
        for variable in (names.variable(end) for end in _ends(names, place)):
            if variable.type not in REALS and np.any(np.abs(signal.numbers) >= EXACT):
                raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected numbers below 2^53")
        yield _Fed(name, place, signal, "", given)


def _by_name(names: SystemNames, file: Path) -> Iterator[_Fed]:
    """The columns of `file` that are called as inputs are."""
    if file.suffix.lower() not in FILES and not os.path.exists(file):
        raise InputRefused(f"--input {file}: expected NAME=SOURCE, such as u=step(1.0), or a CSV file")
    known, table = dict(names.inputs()), read_table(file)
    time = _time(table)
    columns = [head for head in table.head if head != time[0]]
    names_of = {head: (head, "") if head in known else _in_brackets(head) for head in columns}
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
        yield _Fed(name, known[name], samples, spelled, about, tuple(f"{file.name}: {one}" for one in others))


def _input(names: SystemNames, name: str) -> Endpoint:
    place = names.place(name, "--input")
    if not place.element and place.connector not in names.flat.entrances:
        raise InputRefused(f"--input {name}: it is no input of the system")
    if place.element and names.variable(place).causality != "input":
        raise InputRefused(f"--input {name}: it is {names.variable(place).causality}; expected an input")
    return place


def _ends(names: SystemNames, place: Endpoint) -> list[Endpoint]:
    return [place] if place.element else [end for end, _ in names.flat.entrances[place.connector]]


def _is_held(names: SystemNames, place: Endpoint) -> bool:
    """Whether a value holds until the next: what is not continuous does."""
    variables = [names.variable(end) for end in _ends(names, place)]
    return any(v.variability != "continuous" or v.type not in REALS for v in variables)


def _refuse_broken(names: SystemNames, place: Endpoint, samples: SampledSignal, where: str) -> None:
    for variable in (names.variable(end) for end in _ends(names, place)):
        if variable.type not in REALS and not np.all(samples.values == np.rint(samples.values)):
            bad = samples.values[samples.values != np.rint(samples.values)][0]
            raise InputRefused(
                f"{where}: {bad:g} for {variable.name}, which is {variable.type}; expected whole numbers"
            )
        _refuse_unfit(variable, samples.values, where)


def _refuse_unfit(variable: Variable, values: np.ndarray, where: str) -> None:
    """Refuse values that the type of `variable` cannot hold, and those that may have been rounded when they were read.

    Raises:
        InputRefused: the first of them.
    """
    for value in map(float, (np.nanmin(values), np.nanmax(values))):
        # a larger number may have been rounded to EXACT when it was read
        if why := variable.unfit(value if abs(value) != EXACT or variable.type in REALS else 2.0 * value):
            raise InputRefused(f"{where}: {why}")


def _series(file: Path, column: str, name: str, where: str, held: bool) -> tuple[SampledSignal, str]:
    """(samples, unit) of a column of a CSV file, or of a series of a recording."""
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
    wanted = column or next((head for head in heads if name in (head, _in_brackets(head)[0])), "")
    if not wanted and len(heads) == 1:
        wanted = heads[0]
    if wanted not in heads:
        wanted = next((head for head in heads if _in_brackets(head)[0] == (wanted or name)), wanted)
    if wanted not in heads:
        hint = nearest(column or name, heads, "it has {}")
        raise InputRefused(f"{where}: {file} has no column '{column or name}'; {hint}")
    return SampledSignal(t, _column(table, wanted), between), _in_brackets(wanted)[1]  # type: ignore[arg-type]


def _in_brackets(head: str) -> tuple[str, str]:
    """Name and unit of a column `u [rpm]`; a unit without brackets may be part of a name."""
    return split_unit(head) if head.rstrip().endswith(("]", ")")) else (head, "")


def _time(table: CsvTable) -> tuple[str, np.ndarray]:
    """The column of time and its values (s)."""
    named = {head: split_unit(head) for head in table.head}
    head = next((head for head, (name, _) in named.items() if name.lower() in TIME_NAMES), None)
    if head is None:
        raise LogRefused(f"{table.path}: no column of time; it has {', '.join(table.head)}; call it time, in s")
    t = _column(table, head)
    if named[head][1]:
        t = unit(named[head][1], f"{table.path}: column '{head}'").in_si(t)
    back = np.flatnonzero(np.diff(t) < 0.0) + 1
    if len(back):
        k = int(back[0])
        raise LogRefused(f"{table.path} line {table.lines[k]}: time runs backwards from {t[k - 1]:g} s to {t[k]:g} s")
    return head, t


def _column(table: CsvTable, head: str) -> np.ndarray:
    wrong = table.mistakes(head)
    if wrong:
        got = f"'{wrong.text}'" if wrong.text else "nothing"
        raise LogRefused(f"{table.path} line {wrong.line}: column '{head}' holds {got}; expected a finite number")
    return table.column(head)


def _sha256(file: Path) -> str:
    return sha256(file) if file.is_file() else "of a folder"


def is_table(component: SspComponent) -> bool:
    """Whether a component of a system is a table of values over time, as OMSimulator has them."""
    return component.type == TABLE or (component.type == "" and component.source.lower().endswith(".csv"))


def tables_beside(package: Package, flat: FlatSystem) -> tuple[FlatSystem, Beside]:
    """`flat` without its tables, and these.

    Raises:
        InputRefused: a table that is no CSV file of the archive, or a column that is not there.
    """
    tables = {path: one for path, one in flat.components.items() if is_table(one)}
    if not tables:
        return flat, Beside()
    components, feeds, about = [], [], {}
    for path, component in tables.items():
        where = f"{package.file}: component '{path}'"
        entry = package.entry(component.source)
        if not entry or not entry.lower().endswith(".csv"):
            raise InputRefused(f"{where}: its table '{component.source}' is no CSV file of this archive")
        content = package.content(entry)
        table = table_of(Path(f"{package.file}: {entry}"), io.BytesIO(content))
        time, t = _time(table)
        used = list(dict.fromkeys(lead.start.connector for lead in flat.leads if lead.start.element == path))
        ports, signals = [], []
        for name, port in zip(used, distinct(word(name) for name in used), strict=True):
            if name not in table.head or name == time:
                raise InputRefused(f"{where}: {entry} has no column '{name}'; {nearest(name, table.head, 'it has {}')}")
            stated = component.connector_of.get(name)
            held = stated is not None and stated.type not in ("", *REALS)
            ports.append(Port(port, 1, (stated.unit if stated else "") or "1", f"column {name} of {entry}"))
            signals.append(SampledSignal(t, _column(table, name), "held" if held else "lines"))
            for lead in flat.leads:
                if lead.start == Endpoint(path, name):
                    spelled = stated.unit if stated else ""
                    by = f"{package.file}: the connection from {'.'.join(lead.start)} to {'.'.join(lead.end)}"
                    feeds.append(Feed(lead.end, f"{topic(path)}.{port}", by, spelled, lead.hops))
        if used:
            components.append(source(topic(path), ports, signals))
        about[path] = entry
    rest = {path: one for path, one in flat.components.items() if path not in tables}
    leads = tuple(lead for lead in flat.leads if lead.start.element not in tables)
    found = Beside(tuple(components), tuple(feeds), signals=tuple(one.name for one in components), about=about)
    return replace(flat, components=rest, leads=leads), found
