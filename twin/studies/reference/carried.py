"""What came with an FMU: results of an experiment, the inputs and parameters that belong to them.

Inside it, where its manifest (FMI-LS-REF, https://modelica.github.io/fmi-ls-ref/main) lists them, as in the Reference
FMUs; or beside it, as in the FMI Cross-Check, https://github.com/modelica/fmi-cross-check. Signals over time are CSV,
the first column is the time in s.
"""

import io
import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from twin.kernel.archive import content_of, entries, entry_of
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_bytes, xml_of
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.variable import Value, given_values
from twin.kernel.recording.logs.csv_file import table_of
from twin.kernel.ssp.ssd import parameter_set
from twin.studies.metrics.response import Curve

HOME = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{HOME}/fmi-ls-manifest.xml"
STANDARD = "org.fmi-standard.fmi-ls-ref"
NAMESPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
MOST_RELATED = 1_000
"""Files of one manifest; an honest one lists a dozen."""
TRUTH = re.compile(rb"(?<=[,;\t])(?:true|false)(?=[,;\t\r\n]|$)", re.IGNORECASE)
"""Fields of the time series of Boolean variables, as some tools write them."""


@dataclass(frozen=True)
class Trial:
    """An experiment that came with an FMU; its times are those of the FMU's default experiment.

    Attributes:
        name: of the experiment.
        results, stimuli, parameters: names of files, "": none.
        inside: whether the files are entries of the archive; else they lie beside the FMU.
    """

    name: str
    results: str = ""
    stimuli: str = ""
    parameters: str = ""
    inside: bool = False


@dataclass(frozen=True)
class Series:
    """Signals over time.

    Attributes:
        where: the file, for sentences.
        t: s, never descending, (rows,); the same time twice is a jump.
        signals: by column, (rows,).
        others: columns that are not of single numbers.
    """

    where: str
    t: Curve
    signals: dict[str, Curve]
    others: tuple[str, ...] = ()

    def held(self, name: str, t: Curve) -> Curve:
        """A signal at the times `t`: the value of the last row until then, of the first one before that."""
        return self.signals[name][self._last(t)]

    def linear(self, name: str, t: Curve) -> Curve:
        """A signal at the times `t`, on lines between rows; at a jump what comes after it."""
        values, last = self.signals[name], self._last(t)
        following = np.minimum(last + 1, len(self.t) - 1)
        span = self.t[following] - self.t[last]
        share = np.clip(np.divide(t - self.t[last], span, out=np.zeros(len(t)), where=span > 0.0), 0.0, 1.0)
        return np.asarray(values[last] + share * (values[following] - values[last]))

    def _last(self, t: Curve) -> np.ndarray:
        # a tick's time is a product and may lie below the row's by its rounding
        near = t + 1e-9 * max(1.0, float(np.abs(self.t).max()))
        return np.maximum(np.searchsorted(self.t, near, side="right") - 1, 0)


@dataclass(frozen=True)
class Prepared:
    """A trial whose files have been read.

    Attributes:
        parameters: in the FMU's own units.
        stimuli, results: None where there are none.
    """

    parameters: dict[str, Value]
    stimuli: Series | None
    results: Series | None


@dataclass(frozen=True)
class Carried:
    """What came with an FMU.

    Attributes:
        unread: (name, why) of listed experiments, parameters and results that are not read.
        trials: what can be tried.
    """

    unread: tuple[tuple[str, str], ...]
    trials: tuple[Trial, ...]


def carried(file: Path) -> Carried:
    """What came with the FMU `file`; nothing of it is run or unpacked.

    Raises:
        InputRefused: no sound archive, or a manifest that is none.
    """
    results, parameters, unread = [], "", []
    names = entries(file)
    for source, role, type_ in _listed(file, names):
        entry = entry_of(source, names, MANIFEST)
        if role not in ("experiment", "parameter", "result"):
            continue
        if not entry:
            unread.append((source, "not in the FMU; expected the name of one of its files"))
        elif role == "result" and (type_ == "text/csv" or entry.endswith(".csv")):
            results.append(entry)
        elif role == "parameter" and entry.endswith(".ssv") and not parameters:
            parameters = entry
        else:
            unread.append((source, f"{role} of type {type_}; read are results (CSV) and one set of parameters (SSV)"))
    trials = [
        Trial(PurePosixPath(entry).name, entry, fed if (fed := _inputs_of(entry)) in names else "", parameters, True)
        for entry in results
    ]
    return Carried(tuple(unread), (*trials, *_beside(file)))


def _listed(file: Path, names: dict[str, int]) -> list[tuple[str, str, str]]:
    """(source, role, type) of the files that the manifest lists; nothing if there is none."""
    if MANIFEST not in names:
        return []
    where = f"{file}: {MANIFEST}"
    root = xml_of(content_of(file, MANIFEST), where)
    named = root.get(f"{NAMESPACE}fmi-ls-name")
    if root.tag != "fmiReferences" or named != STANDARD:
        raise InputRefused(f"{where}: <{root.tag}> of '{named}'; expected <fmiReferences> of '{STANDARD}'")
    listed = root.findall("Related")
    if len(listed) > MOST_RELATED:
        raise InputRefused(f"{where}: lists {len(listed)} files; expected at most {MOST_RELATED}")
    return [(e.get("source", ""), e.get("role", "").split("/")[0], e.get("type", "not stated")) for e in listed]


def _inputs_of(results: str) -> str:
    """The inputs that belong to NAME_ref.csv or NAME_out.csv: NAME_in.csv."""
    return re.sub(r"(_ref|_out)?\.csv$", "_in.csv", results)


def _beside(file: Path) -> list[Trial]:
    """The experiment of the FMI Cross-Check: NAME_ref.csv and NAME_in.csv beside NAME.fmu."""
    results = file.with_name(f"{file.stem}_ref.csv")
    stimuli = _inputs_of(results.name)
    found = Trial(results.name, results.name, stimuli if file.with_name(stimuli).is_file() else "")
    return [found] if results.is_file() else []


def prepared(file: Path, trial: Trial, description: FmuDescription) -> Prepared:
    """The files of a trial, read and held to the FMU.

    Raises:
        InputRefused: one cannot be read, or does not fit the FMU.
    """

    def read(name: str) -> tuple[bytes, str]:
        if trial.inside:
            return content_of(file, name), f"{file.name}: {PurePosixPath(name).name}"
        return read_bytes(file.with_name(name)), name

    parameters = parameters_of(*read(trial.parameters), description) if trial.parameters else {}
    stimuli, results = (series_of(*read(name)) if name else None for name in (trial.stimuli, trial.results))
    return Prepared(parameters, stimuli, results)


def parameters_of(content: bytes, where: str, description: FmuDescription) -> dict[str, Value]:
    """The values of a parameter set (SSV), which are in the FMU's own units.

    Raises:
        InputRefused: a parameter that the FMU has not, or cannot take, or in another unit than the FMU's.
    """
    given: dict[str, Value] = {}
    for one in parameter_set(content, where).parameters:
        known = description.variables.get(one.name)
        if known is not None and one.unit not in ("", None, known.unit):
            raise InputRefused(f"{where}: {one.name} in '{one.unit}'; expected '{known.unit}', as in the FMU")
        values = given_values(one, where)
        given[one.name] = values[0] if len(values) == 1 else values
    try:
        description.settings(given)
    except InputRefused as refusal:
        raise InputRefused(f"{where}: {str(refusal).removeprefix(f'{description.path}: ')}") from None
    return given


def series_of(content: bytes, where: str) -> Series:
    """The signals in the CSV `content`.

    Raises:
        InputRefused: no table of numbers, a time that is missing, no number or descends, a field that is no number
            among numbers.
    """
    numbers = TRUTH.sub(lambda field: b"1" if field[0].lower() == b"true" else b"0", content)
    table = table_of(Path(where), io.BytesIO(numbers))
    time = table.head[0]
    if wrong := table.mistakes(time):
        raise InputRefused(f"{where} line {wrong.line}: time '{wrong.text}'; expected seconds in the first column")
    t = table.column(time)
    if len(back := np.flatnonzero(np.diff(t) < 0.0)):
        k = back[0] + 1
        raise InputRefused(
            f"{where} line {table.lines[k]}: time falls from {t[k - 1]:g} to {t[k]:g} s; expected rising"
        )
    signals, others = {}, []
    for name in table.head[1:]:
        wrong = table.mistakes(name)
        if wrong is None:
            signals[name] = table.column(name)
        elif wrong.count == len(table.values) and wrong.texts:
            others.append(name)
        else:
            raise InputRefused(f"{where} line {wrong.line}: {name} is '{wrong.text}'; expected a finite number")
    return Series(where, t, signals, tuple(others))
