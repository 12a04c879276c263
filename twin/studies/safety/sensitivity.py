"""Sensitivity to the monitor's thresholds: false trips of healthy robots, and worst peaks."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from twin.kernel.errors import InputRefused, TwinError, nearest
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import toml_keys
from twin.robot.monitor.limits import Monitor
from twin.studies.faults.cases import faults_of
from twin.studies.faults.stage import Stage
from twin.studies.figure import GREY, PAPER_BLUE, VERMILION, picture
from twin.studies.safety.evidence import HazardLine
from twin.studies.safety.hazards import Sensitivity


class ThresholdPoint(NamedTuple):
    """Results of one monitor threshold at one value: false trips and the worst peak.

    Attributes:
        factor: factor on the experiment's value.
        value: value in the unit of the key.
        false_trips: number of healthy robots that trip.
        peak: largest force (N) of the worst runs of all lines that are kept at the experiment's own thresholds.
    """

    key: str
    factor: float
    value: float
    false_trips: int
    fleet: int
    peak: float


def threshold_points(
    asked: Sensitivity,
    path: Path,
    settings: Sequence[str],
    worst: Sequence[tuple[HazardLine, Stage]],
    say: Callable[[str], None],
) -> list[ThresholdPoint]:
    """Count false trips and the worst peak per threshold and factor, except values that contradict other limits."""
    found = []
    for key in asked.keys:
        nominal = nominal_value(path, settings, key)
        for factor in asked.factors:
            say(f"monitor.{key} times {factor:g}")
            value = float(f"{nominal * factor:.6g}")
            changed = f"monitor.{key}={value!r}"
            try:
                fleet = [
                    load_experiment(path, (*settings, *own, changed), None, body)
                    for body in asked.bodies
                    for own in asked.fleet
                ]
            except TwinError:
                continue
            trips = sum(_trips(robot) for robot in fleet)
            peaks = [_peak(line, robot, path, changed) for line, robot in worst if line.status == "kept"]
            found.append(ThresholdPoint(key, factor, value, trips, len(fleet), max(peaks, default=0.0)))
    return found


def nominal_value(path: Path, settings: Sequence[str], key: str) -> float:
    """Return the experiment's own value of a monitor threshold `key`, in the key's unit."""
    fields = {str(field.alias): field.default for field in Monitor.model_fields.values()}
    if not isinstance(fields.get(key), float):
        raise InputRefused(
            f"[sensitivity] keys: '{key}' is not a number of [monitor]; {nearest(key, list(toml_keys(Monitor)))}"
        )
    return float(load_experiment(path, settings).values["monitor"].get(key) or fields[key])


def _trips(experiment: Experiment) -> bool:
    run = Stage(experiment, share=False).reaction(())
    return bool(run.reason or run.failure)


def _peak(line: HazardLine, robot: Stage, path: Path, changed: str) -> float:
    assert line.worst is not None
    experiment = load_experiment(path, (*robot.settings, changed), None, robot.body)
    return Stage(experiment, share=False).reaction(faults_of(experiment, line.worst.tables)).peak


def draw_sensitivity(points: Sequence[ThresholdPoint], path: Path) -> None:
    """Draw the share of healthy robots that trip, and the worst peak, against each monitor threshold, to `path`."""
    keys = list(dict.fromkeys(point.key for point in points))
    with picture(
        path, 9.0, 1.2 + 2.6 * len(keys), "Thresholds of the monitor: false trips and the worst peak"
    ) as figure:
        for axes, key in zip(figure.subplots(len(keys), 1, squeeze=False)[:, 0], keys, strict=True):
            mine = [point for point in points if point.key == key]
            values = [point.value for point in mine]
            share = [100.0 * point.false_trips / point.fleet for point in mine]
            axes.plot(values, share, "o-", color=PAPER_BLUE)
            axes.axvline(mine[0].value / mine[0].factor, color=GREY, ls=":")
            span = f"{mine[0].factor:g} to {mine[-1].factor:g}"
            axes.set(xlabel=f"{key}, the experiment's own (dotted) times {span}", ylim=(-5, 105))
            axes.set_ylabel("healthy robots that trip (%)", color=PAPER_BLUE)
            other = axes.twinx()
            other.plot(values, [point.peak for point in mine], "s--", color=VERMILION)
            other.set_ylabel("worst peak (N)", color=VERMILION)
            other.set_ylim(bottom=0.0)
