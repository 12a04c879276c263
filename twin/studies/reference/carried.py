"""What came with an FMU: results of an experiment, the inputs and parameters that belong to them.

Inside it, where its manifest (FMI-LS-REF, https://modelica.github.io/fmi-ls-ref/main) lists them, as in the Reference
FMUs; or beside it, as in the FMI Cross-Check, https://github.com/modelica/fmi-cross-check.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from twin.archive import content_of, entries, entry_of
from twin.cosim.ssp.ssd import parameter_set
from twin.cosim.ssp.structure import finite
from twin.drive.description import FmuDescription
from twin.drive.setting import Value, given_values
from twin.errors import InputRefused
from twin.files import read_bytes, read_text, xml_of
from twin.studies.reference.series import Series, series_of

HOME = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{HOME}/fmi-ls-manifest.xml"
STANDARD = "org.fmi-standard.fmi-ls-ref"
NAMESPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
MOST_RELATED = 1_000
"""Files of one manifest; an honest one lists a dozen."""
OPTION = re.compile(r"\s*\"?(\w+)\"?\s*[,;=:\s]\s*\"?([^\s\";,]+)")
OPTIONS = {"starttime": "start", "stoptime": "stop", "stepsize": "step", "reltol": "tolerance"}


@dataclass(frozen=True)
class Trial:
    """An experiment that came with an FMU; what it does not state is the FMU's default experiment.

    Attributes:
        name: of the experiment.
        results, stimuli, parameters: names of files, "": none.
        inside: whether the files are entries of the archive; else they lie beside the FMU.
        start, stop, step: s; None: not stated.
        tolerance: relative, of the FMU's solver; None likewise.
    """

    name: str
    results: str = ""
    stimuli: str = ""
    parameters: str = ""
    inside: bool = False
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


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
        InputRefused: no sound archive, or a manifest or options that are none.
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
        Trial(PurePosixPath(entry).name, entry, told if (told := _inputs_of(entry)) in names else "", parameters, True)
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
    """The experiment of the FMI Cross-Check: NAME_ref.csv, NAME_in.csv and NAME_ref.opt beside NAME.fmu."""
    results, options = file.with_name(f"{file.stem}_ref.csv"), file.with_name(f"{file.stem}_ref.opt")
    if not results.is_file():
        return []
    stimuli = _inputs_of(results.name)
    found = Trial(results.name, results.name, stimuli if file.with_name(stimuli).is_file() else "")
    return [replace(found, **options_of(read_text(options), options.name)) if options.is_file() else found]


def options_of(text: str, where: str) -> dict[str, Any]:
    """Keys `start`, `stop`, `step`, `tolerance` of `Trial` that the lines of a _ref.opt give.

    A step of 0 says that the exporting tool chose its steps itself, and is left out.

    Raises:
        InputRefused: one of these is no number.
    """
    given = {}
    for line in text.splitlines():
        if (found := OPTION.match(line)) and (key := OPTIONS.get(found[1].lower())):
            given[key] = finite(found[2], f"{where}: {found[1]}")
    return {key: value for key, value in given.items() if value > 0.0 or key == "start"}


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
