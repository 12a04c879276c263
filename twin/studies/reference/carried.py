"""What came with an FMU: files that its manifest lists, and those of the FMI Cross-Check that lie beside it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from twin.archive import content_of, entries, entry_of
from twin.cosim.ssp.parameters import PARAMETER_SET
from twin.cosim.ssp.ssv import parameter_set
from twin.drive.description import FmuDescription
from twin.drive.setting import Value
from twin.errors import InputRefused
from twin.files import read_bytes, read_text
from twin.studies.reference.experiment_file import MIMES, Described, experiments_of, options_of
from twin.studies.reference.parameter_set import settings
from twin.studies.reference.related import Related, related
from twin.studies.reference.series import Series, series_of

CSV = "text/csv"
DEFAULT = "default experiment"


@dataclass(frozen=True)
class Trial:
    """An experiment that came with an FMU.

    Attributes:
        described: what it says, files by URI.
        base: the entry of the archive that the URIs are relative to; "": they lie beside the FMU.
        problem: why it is known already that it cannot be run.
    """

    described: Described
    base: str = ""
    problem: str = ""


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
        listed: by its manifest.
        unread: (name, why) of files of experiments in no form that is read here.
        trials: what can be tried.
    """

    listed: tuple[Related, ...]
    unread: tuple[tuple[str, str], ...]
    trials: tuple[Trial, ...]


def carried(file: Path) -> Carried:
    """What came with the FMU `file`; nothing of it is run or unpacked.

    Files that no experiment names are tried with the FMU's default experiment: results are held to it, parameters are
    set in it.

    Raises:
        InputRefused: no sound archive, or a manifest or options that are none.
    """
    listed = related(file)
    trials: list[Trial] = []
    unread: list[tuple[str, str]] = []
    names = entries(file)
    for one in listed:
        if one.role.split("/")[0] not in ("experiment", "parameter", "result"):
            continue
        if not one.entry:
            unread.append((one.source, "not in the FMU; expected the name of one of its files"))
        elif one.role.startswith("experiment") and one.type not in MIMES and not one.entry.endswith(".exp"):
            unread.append((one.source, f"an experiment of type {one.type}; read are {', '.join(MIMES)}"))
        elif one.role.startswith("experiment"):
            trials += _described(file, one.entry)
    used = {
        entry_of(named[0], names, trial.base)
        for trial in trials
        for named in (trial.described.parameters, trial.described.results)
        if named
    }
    for one in listed:
        if one.entry and one.entry not in used:
            if one.role == "result" and _is_csv(one.type, one.entry):
                unnamed = Described(_name(one), results=(f"/{one.entry}", CSV))
            elif one.role == "parameter" and (one.type == PARAMETER_SET or one.entry.endswith(".ssv")):
                unnamed = Described(_name(one), parameters=(f"/{one.entry}", PARAMETER_SET))
            elif one.role in ("result", "parameter"):
                unread.append((one.source, f"of type {one.type}; read are {CSV} and {PARAMETER_SET}"))
                continue
            else:
                continue
            trials.append(Trial(unnamed, one.entry))
    return Carried(listed, tuple(unread), (*trials, *_beside(file)))


def prepared(file: Path, trial: Trial, description: FmuDescription) -> Prepared:
    """The files of a trial, read and held to the FMU.

    Raises:
        InputRefused: one is missing, in no form that is read here, or does not fit the FMU.
    """
    named = trial.described
    parameters: dict[str, Value] = {}
    if named.parameters:
        content, where = _content(file, trial, named.parameters, (PARAMETER_SET,), ".ssv")
        parameters = settings(parameter_set(content, where), description, where)
    stimuli, results = (
        series_of(*_content(file, trial, one, (CSV,), ".csv")) if one else None
        for one in (named.stimuli, named.results)
    )
    return Prepared(parameters, stimuli, results)


def _described(file: Path, entry: str) -> list[Trial]:
    try:
        return [Trial(found, entry) for found in experiments_of(content_of(file, entry), f"{file.name}: {entry}")]
    except InputRefused as refusal:
        return [Trial(Described(Path(entry).name), entry, str(refusal))]


def _beside(file: Path) -> Sequence[Trial]:
    """The experiment of the FMI Cross-Check: NAME_ref.csv, NAME_in.csv and NAME_ref.opt beside NAME.fmu."""
    results, stimuli, options = (file.with_name(f"{file.stem}_{end}") for end in ("ref.csv", "in.csv", "ref.opt"))
    if not results.is_file():
        return ()
    found = Described(results.name, results=(results.name, CSV))
    if stimuli.is_file():
        found = replace(found, stimuli=(stimuli.name, CSV))
    if options.is_file():
        given = options_of(read_text(options), options.name)
        found = replace(
            found, start=given.get("start"), stop=given.get("stop"), step=given.get("step"),
            tolerance=given.get("tolerance"),
        )  # fmt: skip
    return (Trial(found),)


def _content(
    file: Path, trial: Trial, named: tuple[str, str], types: tuple[str, ...], suffix: str
) -> tuple[bytes, str]:
    uri, type_ = named
    if type_ not in types and not uri.endswith(suffix):
        raise InputRefused(f"{file.name}: {uri} is of type {type_}; read is {types[0]}")
    if not trial.base:
        return read_bytes(file.with_name(uri)), uri
    names = entries(file)
    entry = uri[1:] if uri[1:] in names and uri.startswith("/") else entry_of(uri, names, trial.base)
    if not entry:
        raise InputRefused(f"{file.name}: {uri}: not in the FMU; expected the name of one of its files")
    return content_of(file, entry), f"{file.name}: {Path(entry).name}"


def _is_csv(type_: str, entry: str) -> bool:
    return type_ == CSV or entry.endswith(".csv")


def _name(one: Related) -> str:
    return f"{DEFAULT}, {Path(one.entry).name}"
