"""Comparison of a measurement with its baseline: each number with its bound, each curve with its tube."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin import __version__
from twin.robot.experiment.experiment import Experiment
from twin.studies.check.baseline import Baseline, fingerprint
from twin.studies.check.measurement import Measurement, Metric, SampledCurve
from twin.studies.compare.tolerance import reach
from twin.studies.metrics.response import window_mask

Word = Literal["ok", "worse", "better", "moved", "new", "gone", "outside"]
"""Verdict on a number or tube.

`moved`: beyond its bound, and neither direction is better. `new`, `gone`: missing in the baseline, or in the run.
`outside`: the curve leaves its tube.
"""


@dataclass(frozen=True)
class CheckRow:
    """Comparison of one measured number or curve with its baseline.

    Attributes:
        name: "measure.metric", or "measure.tube".
        before, now: None if missing.
        bound: allowed difference; None if missing.
        at: for a tube, time (s) of the largest departure from the baseline; `before` and `now` are the values then.
    """

    name: str
    unit: str
    before: float | None
    now: float | None
    bound: float | None
    at: float | None
    word: Word


@dataclass(frozen=True)
class TubeDeparture:
    """A curve that leaves the tube around its baseline at instants t (s), (n,), in `unit`, NaN without a value."""

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
    """Comparison of a measurement, of an experiment with one drive, with its baseline."""

    experiment: str
    drive: str
    rows: tuple[CheckRow, ...]
    notes: tuple[str, ...]
    outside: tuple[TubeDeparture, ...] = ()

    @property
    def deviations(self) -> tuple[CheckRow, ...]:
        return tuple(row for row in self.rows if row.word != "ok")


def verdict(experiment: Experiment, drive: str, baseline: Baseline | None, now: Measurement) -> CheckVerdict:
    """Compare a measurement with its baseline; everything is new if the baseline is None.

    A changed experiment or FMU is compared all the same, with a note, because baselines exist for that. A number with a
    changed unit counts as another number: the old one is gone.
    """
    if baseline is None:
        rows = [
            CheckRow(name, metric.unit, None, metric.value, None, None, "new") for name, metric in now.metrics.items()
        ]
        # a new curve is represented by its last value
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


def _metric_rows(baseline: Baseline, now: Measurement) -> Iterator[CheckRow]:
    for name, stored in baseline.metrics.items():
        metric = now.metrics.get(name)
        if metric is None or metric.unit != stored.unit:
            yield CheckRow(name, stored.unit, stored.value, None, None, None, "gone")
            continue
        # NaN is not inside
        inside = abs(metric.value - stored.value) <= stored.bound
        word: Word = "ok" if inside else _direction(metric, stored.value)
        yield CheckRow(name, stored.unit, stored.value, metric.value, stored.bound, None, word)
    for name, metric in now.metrics.items():
        if name not in baseline.metrics or baseline.metrics[name].unit != metric.unit:
            yield CheckRow(name, metric.unit, None, metric.value, None, None, "new")


def _direction(metric: Metric, before: float) -> Word:
    if metric.sense == "none":
        return "moved"
    now = metric.value if metric.sense == "less" else abs(metric.value)
    return "better" if now < (before if metric.sense == "less" else abs(before)) else "worse"


def _tube_row(name: str, tube: SampledCurve, curve: SampledCurve) -> tuple[CheckRow, TubeDeparture]:
    """Compare a curve with the tube around its baseline, at the instants of the baseline."""
    # times in a baseline are rounded, so its ends may differ slightly from the first and last tick
    inside = window_mask(tube.t, curve.t[0], curve.t[-1])
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
    lines = [line.tolist() for line in (tube.t, tube.values, *around.widen(tube.tolerance), y)]
    return row, TubeDeparture(name, tube.signal, tube.unit, *lines)


def _notes(experiment: Experiment, baseline: Baseline, now: Measurement) -> Iterator[str]:
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
