"""A baseline: what an experiment came to with one drive, as a small TOML file that people read and edit.

What is now against what was: each number with its bound, each curve with its tube.

What `twin check` found, as text of at most 80 columns and as pictures.
"""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from twin import __version__
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_toml
from twin.kernel.places import HOME, is_clone
from twin.kernel.writing import inline_table, made_folder, write_text
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import sentences
from twin.studies.check.measurement import POINTS, Measured, Metric, SampledCurve
from twin.studies.compare.comparison import A_COLOUR, B_COLOUR, OUT_COLOUR, shown
from twin.studies.compare.tolerance import reach
from twin.studies.figure import Axes, picture
from twin.studies.metrics.response import within
from twin.studies.result import Block, Column, Note, Result, Row, Table, counted

OWN = "own"
"""Called like a drive: the one that the experiment's file names, with the parameters that it sets."""
FOLDER = Path("tests/baselines")
"""Where baselines are written to and looked for, one folder per experiment."""
BESIDE = "baselines"
"""Where those of somebody's own experiment are in a clone of twin, beside its file."""
_NEUTRAL = ("title", "recording", "drive")
"""Tables that do not change what is measured; drives are listed one by one."""
_LATER = ("tolerance", "position_command", "rotor", "kind", "solver", "solver_step", "unpowered")
"""Keys of [drive] that baselines of before do not know: only where one says something is it another experiment."""
_REFUSING = ("ball_joint_limit_deg", "link_diameter_mm", "rod_diameter_mm", "rod_spacing_mm")
"""Keys of a robot by which a run is refused, and nothing that is measured changes."""
_ANEW = "remove it and write it anew with --update"


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Width = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]


class _Table(BaseModel):
    """A table of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class BaselineMetric(_Table):
    """A number of a baseline: off by more than its bound either way is a deviation.

    Attributes:
        keep: the bound has been chosen by somebody, and an update leaves it.
    """

    value: Number
    unit: str
    bound: Width
    keep: bool = False


class HistoryEntry(_Table):
    """When a baseline was accepted, and why."""

    date: str
    reason: str


class StoredCurve(_Table):
    """A curve, thinned; as `SampledCurve` has it, with the units of times in their names."""

    signal: str
    unit: str
    tolerance: Width
    dt_s: Width
    t_s: tuple[Number, ...]
    values: tuple[Number, ...]

    @model_validator(mode="after")
    def _rising(self) -> "StoredCurve":
        # compared, not subtracted: the difference of two numbers may be more than any number
        rising = len(self.t_s) > 1 and all(before < after for before, after in pairwise(self.t_s))
        if not rising or len(self.t_s) != len(self.values):
            raise ValueError("expected as many numbers in t_s as in values, with times that increase")
        return self

    @property
    def curve(self) -> SampledCurve:
        """The curve, to be compared with."""
        return SampledCurve(
            self.signal, self.unit, np.array(self.t_s), np.array(self.values), self.tolerance, self.dt_s
        )


class Baseline(_Table):
    """What is stored.

    Attributes:
        twin: version that measured it.
        fmus: SHA-256 by file name.
        history: oldest first.
        metrics: by "measure.metric".
        tubes: by measure.
    """

    experiment: str
    drive: str
    fingerprint: str
    twin: str
    fmus: dict[str, str]
    history: tuple[HistoryEntry, ...]
    metrics: dict[str, BaselineMetric]
    tubes: dict[str, StoredCurve] = Field(default={})


def baselines_here() -> Path:
    """`FOLDER` in the current folder; where there is none, those that come with twin."""
    return FOLDER if FOLDER.is_dir() else HOME / FOLDER


def baselines_of(file: Path, update: bool) -> Path:
    """Where the baselines of the experiment in `file` are by default.

    That is `FOLDER` here. In a clone of twin what is there belongs to twin's own experiments, to which the tests hold
    it: the baselines of any other experiment are beside its file.

    Args:
        update: whether they are written, and not only read: then never to those that a wheel carries.
    """
    of_twin = file.resolve().parent == (HOME / "experiments").resolve() and (HOME / FOLDER / file.stem).is_dir()
    if is_clone() and Path.cwd() == HOME.resolve() and not of_twin:
        return file.parent / BESIDE
    return FOLDER if update else baselines_here()


def baseline_file(folder: Path, experiment: str, drive: str) -> Path:
    """Where the baseline of an experiment and a drive (a name, or a path to an FMU) is."""
    return folder / experiment / f"{Path(drive).stem}.toml"


def stored_experiments(folder: Path) -> list[str]:
    """Names of the experiments with a baseline in `folder`; other folders, such as that of tolerances, are skipped."""
    return sorted({file.parent.name for file in folder.glob("*/*.toml")})


def stored_drives(folder: Path, experiment: str) -> list[str]:
    """The drives for which `experiment` has a baseline in `folder`, as they were named."""
    files = sorted((folder / experiment).glob("*.toml")) if os.path.isdir(folder) else []
    return [read_baseline(file).drive for file in files]


def fingerprint(experiment: Experiment) -> str:
    """Tells an experiment from one whose results may be others: a hash over what its file says, drives included.

    Files of FMUs are left out: they have hashes of their own.
    """
    values = {key: value for key, value in experiment.values.items() if key not in _NEUTRAL}
    for table in ("robot", "plant"):
        values[table] = {key: value for key, value in values[table].items() if key not in _REFUSING}
    drives = [_drive_facts(drive.model_dump()) for drive in experiment.drives]
    text = json.dumps([values, drives], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def baseline_of(
    experiment: Experiment, drive: str, now: Measured, history: Iterable[HistoryEntry], before: Baseline | None
) -> Baseline:
    """The baseline that `now` makes; the bounds that the one `before` keeps stay."""
    metrics = {}
    for name, metric in now.metrics.items():
        old = before.metrics.get(name) if before else None
        keep = old is not None and old.keep
        bound = old.bound if old is not None and keep else _rounded(metric.bound, 3)
        metrics[name] = BaselineMetric(value=_rounded(metric.value), unit=metric.unit, bound=bound, keep=keep)
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
    """The baseline of `experiment` with `drive`, None if there is none; drives are distinguished by their file names.

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
    """The baseline in `file`."""
    try:
        table = read_toml(file)
    except InputRefused as problem:
        raise InputRefused(f"{problem}; mend it, or {_ANEW}") from None
    try:
        return Baseline.model_validate(table)
    except ValidationError as problem:
        mistake = sentences(problem, Baseline, "")[0].replace("[.", "[").removeprefix("[] ")
        raise InputRefused(f"{file}: no baseline: {mistake}; {_ANEW}") from None


def baseline_text(baseline: Baseline) -> str:
    """`baseline` as TOML, a line per number."""
    text = tomlkit.document()
    about = f"twin check {baseline.experiment} --drive {baseline.drive}"
    text.add(tomlkit.comment(f"{about}: SI units; a bound with keep = true stays"))
    facts = baseline.model_dump(exclude_defaults=True)
    facts["metrics"] = {name: inline_table(stored) for name, stored in facts["metrics"].items()}
    for tube in facts.get("tubes", {}).values():
        tube |= {name: _array(tube[name]) for name in ("t_s", "values")}
    text.update(facts)
    return tomlkit.dumps(text)


def write_baseline(file: Path, text: str) -> None:
    """Write the `text` of a baseline."""
    made_folder(file.parent)
    write_text(file, text)


def _array(values: Sequence[float]) -> Any:
    """An array of TOML with ten numbers a line."""
    array = tomlkit.array()
    for start in range(0, len(values), 10):
        array.add_line(*values[start : start + 10], indent="  ")
    array.add_line(indent="")
    return array


def _thinned(curve: SampledCurve) -> StoredCurve:
    """Some samples, evenly spread, with six digits."""
    chosen = np.unique(np.linspace(0, len(curve.t) - 1, POINTS).round().astype(int))
    return StoredCurve(
        signal=curve.signal,
        unit=curve.unit,
        tolerance=_rounded(curve.tolerance, 3),
        dt_s=curve.dt,
        t_s=tuple(round(float(curve.t[k]), 9) for k in chosen),
        values=tuple(_rounded(float(curve.values[k])) for k in chosen),
    )


def _rounded(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def _drive_facts(drive: dict[str, Any]) -> dict[str, Any]:
    """What a table [drive], or one of its parts, says: without places of FMUs, and later keys that say nothing."""
    keys = {k: v for k, v in drive.items() if k != "fmu" and not (k in _LATER and v is None)}
    return keys | (
        {"parts": {name: _drive_facts(part) for name, part in drive["parts"].items()}} if "parts" in drive else {}
    )


Word = Literal["ok", "worse", "better", "moved", "new", "gone", "outside"]
"""`moved`: beyond its bound, where neither way is better. `new`, `gone`: only now, only then. `outside`: of a tube."""


@dataclass(frozen=True)
class CheckRow:
    """One number or one tube.

    Attributes:
        name: "measure.metric", or "measure.tube".
        before, now: None where there is none.
        bound: how far apart they may be; None likewise.
        at: for a tube, the time (s) at which it is farthest outside, or nearest to that; before, now are values there.
    """

    name: str
    unit: str
    before: float | None
    now: float | None
    bound: float | None
    at: float | None
    word: Word


@dataclass(frozen=True)
class Outside:
    """A curve that has left its tube, at the instants t (s) of the tube, (n,); in `unit`, NaN where it has no value.

    Attributes:
        before: the baseline.
        lower, upper: the tube around it.
    """

    name: str
    signal: str
    unit: str
    t: list[float]
    before: list[float]
    lower: list[float]
    upper: list[float]
    now: list[float]


@dataclass(frozen=True)
class CheckVerdict:
    """An experiment with one drive against its baseline.

    Attributes:
        notes: what has changed besides, a sentence each.
        outside: of what tubes have lost.
    """

    experiment: str
    drive: str
    rows: tuple[CheckRow, ...]
    notes: tuple[str, ...]
    outside: tuple[Outside, ...] = ()

    @property
    def deviations(self) -> tuple[CheckRow, ...]:
        return tuple(row for row in self.rows if row.word != "ok")


def verdict(experiment: Experiment, drive: str, baseline: Baseline | None, now: Measured) -> CheckVerdict:
    """Hold `now` against `baseline`; if there is none, everything is new.

    A changed experiment or FMU is compared all the same, which is what a baseline is for, and a note says so. A number
    that is in another unit than it was is another number: the old one is gone.
    """
    if baseline is None:
        rows = [
            CheckRow(name, metric.unit, None, metric.value, None, None, "new") for name, metric in now.metrics.items()
        ]
        # a curve has no one value; where it ends stands for it
        rows += [
            CheckRow(f"{name}.tube", curve.unit, None, float(curve.values[-1]), None, None, "new")
            for name, curve in now.curves.items()
        ]
        return CheckVerdict(experiment.name, drive, tuple(rows), ())
    rows, outside = list(_metric_rows(baseline, now)), []
    for name, tube in baseline.tubes.items():
        curve = now.curves.get(name)
        if curve is None or (curve.signal, curve.unit) != (tube.signal, tube.unit):
            rows.append(CheckRow(f"{name}.tube", tube.unit, None, None, tube.tolerance, None, "gone"))
        else:
            row, beside = _tube_row(f"{name}.tube", tube.curve, curve)
            rows.append(row)
            outside += [beside] if row.word == "outside" else []
    notes = tuple(_notes(experiment, baseline, now))
    return CheckVerdict(experiment.name, drive, tuple(rows), notes, tuple(outside))


def _metric_rows(baseline: Baseline, now: Measured) -> Iterator[CheckRow]:
    for name, stored in baseline.metrics.items():
        metric = now.metrics.get(name)
        if metric is None or metric.unit != stored.unit:
            yield CheckRow(name, stored.unit, stored.value, None, None, None, "gone")
            continue
        word: Word = "ok"
        # written so that what is not a number is not ok
        if not abs(metric.value - stored.value) <= stored.bound:
            word = _direction(metric, stored.value)
        yield CheckRow(name, stored.unit, stored.value, metric.value, stored.bound, None, word)
    for name, metric in now.metrics.items():
        if name not in baseline.metrics or baseline.metrics[name].unit != metric.unit:
            yield CheckRow(name, metric.unit, None, metric.value, None, None, "new")


def _direction(metric: Metric, before: float) -> Word:
    if metric.sense == "none":
        return "moved"
    now = metric.value if metric.sense == "less" else abs(metric.value)
    return "better" if now < (before if metric.sense == "less" else abs(before)) else "worse"


def _tube_row(name: str, tube: SampledCurve, curve: SampledCurve) -> tuple[CheckRow, Outside]:
    """At the instants that the baseline has, where a thinned curve is as good as the whole."""
    # the times of a baseline are rounded, so its ends may lie beside the first and last tick
    inside = within(tube.t, curve.t[0], curve.t[-1])
    y = np.where(inside, np.interp(tube.t, curve.t, curve.values), np.nan)
    around = reach(tube.t, tube.values, tube.t, tube.dt)
    off = np.abs(around.excess(y))
    worst = int(np.argmax(off))
    row = CheckRow(
        name,
        tube.unit,
        float(tube.values[worst]),
        float(y[worst]),
        tube.tolerance,
        float(tube.t[worst]),
        "ok" if off[worst] <= tube.tolerance else "outside",
    )
    lines = [line.tolist() for line in (tube.t, tube.values, *around.widened(tube.tolerance), y)]
    return row, Outside(name, tube.signal, tube.unit, *lines)


def _notes(experiment: Experiment, baseline: Baseline, now: Measured) -> Iterator[str]:
    if baseline.fingerprint != fingerprint(experiment):
        yield "the experiment's file has changed since the baseline"
    for name, digest in now.fmus.items():
        was = baseline.fmus.get(name)
        if was is None:
            yield f"{name} is another FMU than the baseline's {', '.join(baseline.fmus)}"
        elif was != digest:
            yield f"{name} has changed: was sha256 {was[:12]}, now {digest[:12]}"
    for name, stored in baseline.metrics.items():
        if name in now.metrics and now.metrics[name].unit != stored.unit:
            yield f"{name} was in {stored.unit} and is in {now.metrics[name].unit}: another quantity, not compared"
    if baseline.twin != __version__:
        yield f"the baseline was measured by twin {baseline.twin}, this is {__version__}"


LONGEST = 33
"""Of names beside their numbers; longer ones have a line of their own."""
COLUMNS = (
    Column("", 7, left=True),
    Column("metric", left=True),
    Column("unit", 6, left=True),
    Column("baseline", 10, ".4g", gap=0),
    Column("now", 10, ".4g", gap=0),
    Column("bound", 10, ".4g", gap=0),
)
MOST = 5
"""The most deviating checks that are shown in full; the others in a line. All are in the JSON."""


def check_result(verdicts: Sequence[CheckVerdict], failures: Sequence[str]) -> Result:
    """The answer first; of a single check every number, of many only those that deviate."""
    parts: list[Block] = []
    shown = verdicts if len(verdicts) == 1 else [verdict for verdict in verdicts if verdict.deviations]
    shown = [verdict for verdict in shown if len(verdicts) == 1 or not _first(verdict)]
    for verdict in shown[:MOST]:
        rows = verdict.rows if len(verdicts) == 1 else verdict.deviations
        parts += [
            "",
            f"{verdict.experiment}, {verdict.drive}",
            Table(COLUMNS, [row for one in rows for row in _rows(one)]),
        ]
        as_it_was = len(verdict.rows) - len(rows)
        parts += [f"  and {as_it_was} as they were"] if as_it_was else []
        parts += [line for note in verdict.notes for line in _labelled("note", note)]
    parts += [""] * (len(shown) > MOST)
    parts += [f"{verdict.experiment}, {verdict.drive}: {_words([verdict])}" for verdict in shown[MOST:]]
    # a note that a hundred checks share is shown once
    others = Counter(note for verdict in verdicts if verdict not in shown[:MOST] for note in verdict.notes)
    parts += [""] * bool(others)
    for note, count in others.items():
        parts += _labelled("note", f"{note} ({count} checks)" if count > 1 else note)
    parts += [""] * bool(failures)
    parts += [line for failure in dict.fromkeys(failures) for line in _labelled("not done", failure)]
    return Result(_answer(verdicts, failures), parts)


def _answer(verdicts: Sequence[CheckVerdict], failures: Sequence[str]) -> str:
    missed = f"{counted(len(failures), 'check')} could not be done" if failures else ""
    if not verdicts:
        return missed
    experiments, drives = {v.experiment for v in verdicts}, {v.drive for v in verdicts}
    rows = sum(len(verdict.rows) for verdict in verdicts)
    of = f"{counted(len(experiments), 'experiment')}, {counted(len(drives), 'drive')}, {rows} numbers and curves"
    first = [verdict for verdict in verdicts if _first(verdict)]
    wrong = [verdict for verdict in verdicts if verdict.deviations and verdict not in first]
    added = f"{counted(len(first), 'check')} without a baseline until now" if first else ""
    if len(first) == len(verdicts):
        return "; ".join(filter(None, (f"New: {of}", missed)))
    if not wrong:
        return "\n  ".join(filter(None, (f"All as it was: {of}", added, missed)))
    share = f"{len(wrong)} of {counted(len(verdicts), 'check')} {'deviates' if len(wrong) == 1 else 'deviate'}"
    head = f"{share if len(verdicts) > 1 else 'Deviates'}: {_words(wrong)}"
    return "\n  ".join(filter(None, (head, f"of {of}", added, missed)))


def _words(verdicts: Sequence[CheckVerdict]) -> str:
    """`3 worse, 1 outside`."""
    words = Counter(row.word for verdict in verdicts for row in verdict.deviations)
    return ", ".join(f"{count} {word}" for word, count in words.most_common())


def _first(verdict: CheckVerdict) -> bool:
    """Whether there was no baseline."""
    return all(row.word == "new" for row in verdict.rows)


def _rows(row: CheckRow) -> list[Row]:
    unit, factor = shown(row.unit)
    numbers = [nan if value is None else factor * value for value in (row.before, row.now, row.bound)]
    name = _name(row)
    if len(name) > LONGEST:
        return [f"  {row.word:7} {name}", ("", "", unit, *numbers)]
    return [(row.word, name, unit, *numbers)]


def _name(row: CheckRow) -> str:
    return row.name if row.at is None or row.word == "ok" else f"{row.name} at {row.at:.4g} s"


def _labelled(label: str, text: str) -> list[Note]:
    first, *others = text.splitlines()
    return [Note(first, f"  {label:9}", whole=True), *(Note(line, " " * 11, whole=True) for line in others)]


def check_pictures(verdicts: Sequence[CheckVerdict], folder: Path) -> list[Path]:
    """Draw the first MOST of `verdicts` with curves outside, a PNG each in `folder`; the files."""
    drawn = []
    made_folder(folder)
    for verdict in [verdict for verdict in verdicts if verdict.outside][:MOST]:
        path = folder / f"{verdict.experiment}_{Path(verdict.drive).stem}.png"
        _draw_verdict(verdict, path)
        drawn.append(path)
    return drawn


def _draw_verdict(verdict: CheckVerdict, path: Path) -> None:
    with picture(path, 8.0, 3.2 * len(verdict.outside) + 0.5) as figure:
        panels = figure.subplots(len(verdict.outside), squeeze=False)[:, 0]
        for axes, curve in zip(panels, verdict.outside, strict=True):
            _draw(axes, curve)
        panels[-1].set_xlabel("time (s)")
        figure.suptitle(f"{verdict.experiment}, {verdict.drive}", fontsize=11)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)


def _draw(axes: Axes, curve: Outside) -> None:
    unit, factor = shown(curve.unit)
    t = np.array(curve.t)
    before, lower, upper, now = (
        factor * np.array(line) for line in (curve.before, curve.lower, curve.upper, curve.now)
    )
    out = (now < lower) | (now > upper)
    axes.fill_between(t, lower, upper, color=A_COLOUR, alpha=0.25, lw=0, label="tolerance tube")
    axes.plot(t, before, color=A_COLOUR, lw=1.6, label="baseline")
    axes.plot(t, now, color=B_COLOUR, lw=1.0, marker=".", label="now")
    axes.plot(t[out], now[out], "o", mfc="none", color=OUT_COLOUR, ms=7, label="outside")
    axes.set_title(f"{curve.name}: {curve.signal}", loc="left", fontsize=10)
    axes.set_ylabel(unit or "1")
