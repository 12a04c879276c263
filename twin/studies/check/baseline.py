"""A baseline: what an experiment came to with one drive, as a small TOML file that people read and edit."""

import hashlib
import json
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin import __version__
from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.files import read_toml
from twin.places import HOME, is_clone
from twin.studies.check.measurement import POINTS, Measured, Sampled
from twin.writing import made_folder, write_text

OWN = "own"
"""Called like a drive: the one that the experiment's file names, with the parameters that it sets."""
FOLDER = Path("tests/baselines")
"""Where baselines are written to and looked for, one folder per experiment."""
BESIDE = "baselines"
"""Where those of somebody's own experiment are in a clone of twin, beside its file."""
_UNTOLD = ("title", "recording", "drive")
"""Tables that do not change what is measured; drives are told of one by one."""
_LATER = ("tolerance", "position_command", "rotor", "kind", "solver", "solver_step")
"""Keys of [drive] that baselines of before do not know: only where one says something is it another experiment."""
_REFUSING = ("ball_joint_limit_deg", "link_diameter_mm", "rod_diameter_mm", "rod_spacing_mm")
"""Keys of a robot by which a run is refused, and nothing that is measured changes."""
_ANEW = "remove it and write it anew with --update"


@dataclass(frozen=True)
class Kept:
    """A number of a baseline: off by more than its bound either way is a deviation.

    Attributes:
        value, bound: in `unit`, SI.
        keep: the bound has been chosen by somebody, and an update leaves it.
    """

    value: float
    unit: str
    bound: float
    keep: bool = False


@dataclass(frozen=True)
class Entry:
    """When a baseline was accepted, and why."""

    date: str
    reason: str


@dataclass(frozen=True)
class Baseline:
    """What is stored.

    Attributes:
        experiment, drive: their names.
        fingerprint: of the experiment.
        fmus: SHA-256 by file name.
        twin: version that measured it.
        history: oldest first.
        metrics: by "measure.metric".
        tubes: by measure.
    """

    experiment: str
    drive: str
    fingerprint: str
    fmus: dict[str, str]
    twin: str
    history: tuple[Entry, ...]
    metrics: dict[str, Kept]
    tubes: dict[str, Sampled]


def baselines_here() -> Path:
    """`FOLDER` in the current folder; where there is none, those that come with twin."""
    return FOLDER if FOLDER.is_dir() else HOME / FOLDER


def baselines_of(file: Path, update: bool) -> Path:
    """Where the baselines of the experiment in `file` are, if nobody says where.

    That is `FOLDER` here. In a clone of twin what is there belongs to twin's own experiments, to which the tests hold
    it: the baselines of any other experiment are beside its file.

    Args:
        file: of the experiment.
        update: whether they are written, and not only read: then never to those that a wheel carries.
    """
    of_twin = file.resolve().parent == (HOME / "experiments").resolve() and (HOME / FOLDER / file.stem).is_dir()
    if is_clone() and Path.cwd() == HOME.resolve() and not of_twin:
        return file.parent / BESIDE
    return FOLDER if update else baselines_here()


def baseline_file(folder: Path, experiment: str, drive: str) -> Path:
    """Where the baseline of an experiment and a drive (a name, or a path to an FMU) is."""
    return folder / experiment / f"{Path(drive).stem}.toml"


def stored_drives(folder: Path, experiment: str) -> list[str]:
    """The drives for which `experiment` has a baseline in `folder`, as they were named."""
    files = sorted((folder / experiment).glob("*.toml")) if os.path.isdir(folder) else []
    return [read_baseline(file).drive for file in files]


def fingerprint(experiment: Experiment) -> str:
    """Tells an experiment from one whose results may be others: a hash over what its file says, drives included.

    Files of FMUs are left out: they have hashes of their own.
    """
    values = {key: value for key, value in experiment.values.items() if key not in _UNTOLD}
    for table in ("robot", "plant"):
        values[table] = {key: value for key, value in values[table].items() if key not in _REFUSING}
    drives = [_told(drive.model_dump()) for drive in experiment.drives]
    text = json.dumps([values, drives], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def baseline_of(
    experiment: Experiment, drive: str, now: Measured, history: Iterable[Entry], before: Baseline | None
) -> Baseline:
    """The baseline that `now` makes; the bounds that the one `before` keeps stay."""
    metrics = {}
    for name, metric in now.metrics.items():
        old = before.metrics.get(name) if before else None
        kept = old is not None and old.keep
        bound = old.bound if old is not None and kept else _rounded(metric.bound, 3)
        metrics[name] = Kept(_rounded(metric.value), metric.unit, bound, kept)
    return Baseline(
        experiment=experiment.name,
        drive=drive,
        fingerprint=fingerprint(experiment),
        fmus=now.fmus,
        twin=__version__,
        history=tuple(history),
        metrics=metrics,
        tubes={name: _thinned(curve) for name, curve in now.curves.items()},
    )


def known_baseline(folder: Path, experiment: str, drive: str) -> Baseline | None:
    """The baseline of `experiment` with `drive`, None if there is none; drives are told apart by their file names.

    Raises:
        InputRefused: the file that should be it cannot be read, is no baseline, or one of another pair.
    """
    file = baseline_file(folder, experiment, drive)
    # not Path.exists, which raises for a name that is too long
    if not os.path.exists(file):
        return None
    found = read_baseline(file)
    if (found.experiment, Path(found.drive).stem) != (experiment, Path(drive).stem):
        raise InputRefused(
            f"{file}: the baseline of {found.experiment} with {found.drive}, expected that of {experiment} with "
            f"{drive}; move it to where it belongs, or {_ANEW}"
        )
    return found


def read_baseline(file: Path) -> Baseline:
    """The baseline in `file`.

    Raises:
        InputRefused: it cannot be read, or is no baseline.
    """
    try:
        table = read_toml(file)
    except InputRefused as problem:
        raise InputRefused(f"{problem}; mend it, or {_ANEW}") from None
    try:
        return Baseline(
            experiment=_text(table, "experiment"),
            drive=_text(table, "drive"),
            fingerprint=_text(table, "fingerprint"),
            fmus=dict(table["fmus"]),
            twin=_text(table, "twin"),
            history=tuple(Entry(**entry) for entry in table["history"]),
            metrics={name: _kept(name, kept) for name, kept in dict(table["metrics"]).items()},
            tubes={name: _tube(name, tube) for name, tube in dict(table.get("tubes", {})).items()},
        )
    except KeyError as missing:
        raise InputRefused(f"{file}: no baseline: missing key {missing}; {_ANEW}") from None
    except (TypeError, ValueError) as problem:
        raise InputRefused(f"{file}: no baseline: {problem}; {_ANEW}") from None


def baseline_text(baseline: Baseline) -> str:
    """`baseline` as TOML, a line per number."""
    return "\n".join(_lines(baseline)) + "\n"


def write_baseline(file: Path, text: str) -> None:
    """Write the `text` of a baseline.

    Raises:
        InputRefused, NotWritten: the disk refuses.
    """
    made_folder(file.parent)
    write_text(file, text)


def _lines(b: Baseline) -> Iterable[str]:
    yield f"# twin check {b.experiment} --drive {b.drive}: SI units; a bound with keep = true stays"
    for key in ("experiment", "drive", "fingerprint", "twin"):
        yield f"{key} = {json.dumps(getattr(b, key))}"
    yield "\n[fmus]"
    yield from (f"{json.dumps(name)} = {json.dumps(digest)}" for name, digest in b.fmus.items())
    for entry in b.history:
        yield f"\n[[history]]\ndate = {json.dumps(entry.date)}\nreason = {json.dumps(entry.reason, ensure_ascii=False)}"
    yield "\n[metrics]"
    for name, kept in b.metrics.items():
        keep = ", keep = true" if kept.keep else ""
        yield f'"{name}" = {{ value = {kept.value!r}, unit = "{kept.unit}", bound = {kept.bound!r}{keep} }}'
    for name, tube in b.tubes.items():
        yield f'\n[tubes.{name}]\nsignal = "{tube.signal}"\nunit = "{tube.unit}"'
        yield f"tolerance = {tube.tolerance!r}\ndt_s = {tube.dt!r}"
        yield f"t_s = {_array(tube.t)}\nvalues = {_array(tube.values)}"


def _array(values: np.ndarray) -> str:
    """Ten numbers a line."""
    texts = [repr(float(value)) for value in values]
    return "[\n" + "".join(f"  {', '.join(texts[i : i + 10])},\n" for i in range(0, len(texts), 10)) + "]"


def _text(table: dict[str, Any], key: str) -> str:
    if not isinstance(table[key], str):
        raise TypeError(f"{key} = {table[key]!r}: expected a text")
    return table[key]


def _kept(name: str, table: dict[str, Any]) -> Kept:
    kept = Kept(**table)
    if not (math.isfinite(kept.value) and math.isfinite(kept.bound) and kept.bound >= 0.0):
        raise ValueError(f'"{name}": expected a number and a bound >= 0')
    return kept


def _tube(name: str, table: dict[str, Any]) -> Sampled:
    t, values = np.array(table["t_s"], dtype=float), np.array(table["values"], dtype=float)
    # compared, not subtracted: the difference of two numbers may be more than any number
    rising = len(t) > 1 and np.all(t[1:] > t[:-1])
    if not rising or t.shape != values.shape or not np.all(np.isfinite(t)) or not np.all(np.isfinite(values)):
        raise ValueError(f"tube {name}: expected as many numbers in t_s as in values, with times that increase")
    tolerance, dt = float(table["tolerance"]), float(table["dt_s"])
    if not (math.isfinite(tolerance) and tolerance >= 0.0 and math.isfinite(dt) and dt >= 0.0):
        raise ValueError(f"tube {name}: expected tolerance and dt_s to be numbers >= 0")
    return Sampled(table["signal"], table["unit"], t, values, tolerance, dt)


def _thinned(curve: Sampled) -> Sampled:
    """Some samples, evenly spread, with six digits."""
    chosen = np.unique(np.linspace(0, len(curve.t) - 1, POINTS).round().astype(int))
    t = np.array([round(float(curve.t[k]), 9) for k in chosen])
    values = np.array([_rounded(float(curve.values[k])) for k in chosen])
    return Sampled(curve.signal, curve.unit, t, values, _rounded(curve.tolerance, 3), curve.dt)


def _rounded(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def _told(drive: dict[str, Any]) -> dict[str, Any]:
    """What a table [drive], or one of its parts, says: without places of FMUs, and later keys that say nothing."""
    told = {k: v for k, v in drive.items() if k != "fmu" and not (k in _LATER and v is None)}
    return told | ({"parts": {name: _told(part) for name, part in drive["parts"].items()}} if "parts" in drive else {})
