"""Baselines: the stored results of an experiment with one drive, as a small TOML file that people read and edit."""

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from twin import __version__
from twin.kernel.atomic_write import inline_table, make_folder, write_text
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_toml
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import error_messages
from twin.robot.paths import PROJECT_FOLDER, is_clone
from twin.studies.check.measurement import TUBE_POINTS, Measurement, SampledCurve

OWN_DRIVE = "own"
"""Name for the drive of the experiment's file, with the parameters that it sets."""
BASELINE_FOLDER = Path("tests/baselines")
"""Folder that baselines are written to and read from, with one folder per experiment."""
OWN_BASELINE_FOLDER = "baselines"
"""Folder for the baselines of users' own experiments in a clone of twin, next to the experiment's file."""
_NEUTRAL_TABLES = ("title", "recording", "drive")
"""Tables without an effect on the measures; drives are listed one by one."""
_LATER_DRIVE_KEYS = ("tolerance", "position_command", "rotor", "kind", "solver", "solver_step", "unpowered")
"""Keys of [drive] that old baselines lack: they change the fingerprint only if they are set."""
_REFUSAL_KEYS = ("ball_joint_limit_deg", "link_diameter_mm", "rod_diameter_mm", "rod_spacing_mm")
"""Keys of a robot that may refuse a run, but never change a measure."""
_UPDATE_HINT = "remove it and rewrite it with --update"
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Width = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]


class _Table(BaseModel):
    """Base class of the tables of a baseline file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class BaselineMetric(_Table):
    """A number of a baseline; a change beyond its bound deviates. Updates `keep` the bounds that a user chose."""

    value: Number
    unit: str
    bound: Width
    keep: bool = False


class HistoryEntry(_Table):
    """Date and reason of an accepted baseline update."""

    date: str
    reason: str


class StoredCurve(_Table):
    """A thinned curve of a regression baseline, with the units of times in the names."""

    signal: str
    unit: str
    tolerance: Width
    dt_s: Width
    t_s: tuple[Number, ...]
    values: tuple[Number, ...]

    @model_validator(mode="after")
    def _rising(self) -> "StoredCurve":
        # compared rather than subtracted, because a difference may overflow
        rising = len(self.t_s) > 1 and all(before < after for before, after in pairwise(self.t_s))
        if not rising or len(self.t_s) != len(self.values):
            raise ValueError("expected as many numbers in t_s as in values, with times that increase")
        return self

    @property
    def curve(self) -> SampledCurve:
        return SampledCurve(
            self.signal, self.unit, np.array(self.t_s), np.array(self.values), self.tolerance, self.dt_s
        )


class Baseline(_Table):
    """Regression baseline: the stored results of an experiment with one drive.

    Attributes:
        twin: version of twin that measured it.
        fmus: file name -> SHA-256.
        history: oldest first.
        metrics: "measure.metric" -> number.
        tubes: measure -> curve.
    """

    experiment: str
    drive: str
    fingerprint: str
    twin: str
    fmus: dict[str, str]
    history: tuple[HistoryEntry, ...]
    metrics: dict[str, BaselineMetric]
    tubes: dict[str, StoredCurve] = Field(default={})


def default_baseline_folder() -> Path:
    """Return the folder of the regression baselines: in the current folder, else the one shipped with twin."""
    return BASELINE_FOLDER if BASELINE_FOLDER.is_dir() else PROJECT_FOLDER / BASELINE_FOLDER


def baseline_folder_of(file: Path, update: bool) -> Path:
    """Return the default folder for the regression baselines of the experiment in `file`.

    This is `BASELINE_FOLDER` in the current folder. In a clone of twin that folder belongs to twin's own experiments,
    whose baselines are tested: the baselines of any other experiment are next to its file.

    Args:
        update: whether baselines are written; if so, the folder shipped in a wheel is never returned.
    """
    of_twin = (
        file.resolve().parent == (PROJECT_FOLDER / "experiments").resolve()
        and (PROJECT_FOLDER / BASELINE_FOLDER / file.stem).is_dir()
    )
    if is_clone() and Path.cwd() == PROJECT_FOLDER.resolve() and not of_twin:
        return file.parent / OWN_BASELINE_FOLDER
    return BASELINE_FOLDER if update else default_baseline_folder()


def baseline_file(folder: Path, experiment: str, drive: str) -> Path:
    """Return the path of the regression baseline of an experiment and a drive (name, or path to an FMU)."""
    return folder / experiment / f"{Path(drive).stem}.toml"


def stored_experiments(folder: Path) -> list[str]:
    return sorted({file.parent.name for file in folder.glob("*/*.toml")})


def stored_drives(folder: Path, experiment: str) -> list[str]:
    files = sorted((folder / experiment).glob("*.toml")) if os.path.isdir(folder) else []
    return [read_baseline(file).drive for file in files]


def fingerprint(experiment: Experiment) -> str:
    """Return the hash of an experiment's values and drives, without FMU files, which have hashes of their own."""
    values = {key: value for key, value in experiment.values.items() if key not in _NEUTRAL_TABLES}
    for table in ("robot", "plant"):
        values[table] = {key: value for key, value in values[table].items() if key not in _REFUSAL_KEYS}
    drives = [_drive_facts(drive.model_dump()) for drive in experiment.drives]
    text = json.dumps([values, drives], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def baseline_of(
    experiment: Experiment, drive: str, now: Measurement, history: Iterable[HistoryEntry], before: Baseline | None
) -> Baseline:
    """Make a new baseline from a measurement; bounds that a user chose in the old baseline are kept."""
    metrics = {}
    for name, metric in now.metrics.items():
        old = before.metrics.get(name) if before else None
        keep = old is not None and old.keep
        bound = old.bound if old is not None and keep else _round_digits(metric.default_bound, 3)
        metrics[name] = BaselineMetric(value=_round_digits(metric.value), unit=metric.unit, bound=bound, keep=keep)
    return Baseline(
        experiment=experiment.name,
        drive=drive,
        fingerprint=fingerprint(experiment),
        fmus=now.fmus,
        twin=__version__,
        history=tuple(history),
        metrics=metrics,
        tubes={name: _thin_curve(curve) for name, curve in now.curves.items()},
    )


def known_baseline(folder: Path, experiment: str, drive: str) -> Baseline | None:
    """Read the baseline of an experiment with a drive, distinguished by its file name; None if missing."""
    file = baseline_file(folder, experiment, drive)
    # not Path.exists, which raises for names that are too long
    if not os.path.exists(file):
        return None
    found = read_baseline(file)
    if (found.experiment, Path(found.drive).stem) != (experiment, Path(drive).stem):
        raise InputRefused(
            f"{file}: the baseline of {found.experiment} with {found.drive}, expected that of {experiment} with "
            f"{drive}; move it to where it belongs, or {_UPDATE_HINT}"
        )
    return found


def read_baseline(file: Path) -> Baseline:
    try:
        table = read_toml(file)
    except InputRefused as problem:
        raise InputRefused(f"{problem}; mend it, or {_UPDATE_HINT}") from None
    try:
        return Baseline.model_validate(table)
    except ValidationError as problem:
        mistake = error_messages(problem, Baseline, "")[0].replace("[.", "[").removeprefix("[] ")
        raise InputRefused(f"{file}: no baseline: {mistake}; {_UPDATE_HINT}") from None


def baseline_text(baseline: Baseline) -> str:
    """Format a regression baseline as TOML, with a line per number."""
    text = tomlkit.document()
    about = f"twin check {baseline.experiment} --drive {baseline.drive}"
    text.add(tomlkit.comment(f"{about}: SI units; a bound with keep = true stays"))
    facts = baseline.model_dump(exclude_defaults=True)
    facts["metrics"] = {name: inline_table(stored) for name, stored in facts["metrics"].items()}
    for tube in facts.get("tubes", {}).values():
        tube |= {name: _array(tube[name]) for name in ("t_s", "values")}
    text.update(facts)
    return tomlkit.dumps(text)


def accepted_text(
    experiment: Experiment, drive: str, now: Measurement, before: Baseline | None, date: str, reason: str
) -> str:
    """Return the text of the baseline after a measurement is accepted for `reason`; "" if only the history differs."""
    history = before.history if before else ()
    after = baseline_of(experiment, drive, now, (*history, HistoryEntry(date=date, reason=reason)), before)
    same = before is not None and baseline_text(before) == baseline_text(after.model_copy(update={"history": history}))
    return "" if same else baseline_text(after)


def write_baseline(file: Path, text: str) -> None:
    make_folder(file.parent)
    write_text(file, text)


def _array(values: Sequence[float]) -> Any:
    """Format an array as TOML with ten numbers per line."""
    array = tomlkit.array()
    for start in range(0, len(values), 10):
        array.add_line(*values[start : start + 10], indent="  ")
    array.add_line(indent="")
    return array


def _thin_curve(curve: SampledCurve) -> StoredCurve:
    """Thin a curve for a baseline to `TUBE_POINTS` evenly spread samples with six digits."""
    chosen = np.unique(np.linspace(0, len(curve.t) - 1, TUBE_POINTS).round().astype(int))
    return StoredCurve(
        signal=curve.signal,
        unit=curve.unit,
        tolerance=_round_digits(curve.tolerance, 3),
        dt_s=curve.dt,
        t_s=tuple(round(float(curve.t[k]), 9) for k in chosen),
        values=tuple(_round_digits(float(curve.values[k])) for k in chosen),
    )


def _round_digits(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def _drive_facts(drive: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a drive table that identify a drive, without FMU paths and unset newer keys."""
    keys = {k: v for k, v in drive.items() if k != "fmu" and not (k in _LATER_DRIVE_KEYS and v is None)}
    return keys | (
        {"parts": {name: _drive_facts(part) for name, part in drive["parts"].items()}} if "parts" in drive else {}
    )
