"""Measures of a run: the numbers of each [[measure]] table, their default bounds, and curves for tubes.

The same program reproduces its numbers byte for byte on the same machine. The mathematical library of another machine
rounds differently, which an encoder occasionally turns into a count: over a whole response well below 2 % of a number.
A share is meaningless for a number near zero, so each number also has a floor, the possible effect of counts on it: one
controller period for a time, 2 mN, 2 um.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused, SafetyTrip, nearest
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import DrivePlan
from twin.robot.assembly.roles import ThirdPartyPart
from twin.robot.experiment import measure as measures
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.measure import Measure, ReferenceMeasure, RequirementMeasure, SignalMeasure
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.monitor.component import trip_reason
from twin.robot.run.trace import Trace, fields_of
from twin.studies.metrics import response
from twin.studies.metrics.requirement import checked_requirement, distance
from twin.studies.metrics.response import Curve

BOUND_SHARE = 0.02
UNIT_FLOORS = {
    "s": 2e-3,
    "m": 2e-6,
    "N": 2e-3,
    "rad": 5e-5,
    "rad/s": 1e-3,
    "m/s": 2e-6,
    "N m": 1e-4,
    "J": 1e-4,
    "1": 2e-3,
}
"""Floors by SI unit. Angle: 2 um at a link of 60 mm; energy: a tenth of a millijoule; share: 0.2 %."""

Sense = Literal["less", "nearer zero", "none"]
REFERENCE_THETA_L = "reference.theta_l"
"""Load angles (rad) that place the platform of the controller's model at controller.p_ref_B."""
SETTLING_FLOOR = 0.02
"""Floor of settling times (s): flat responses leave their band, so a count shifts the time by more than a tick."""
LAG_FLOOR = 5e-4
"""Floor of lags (s), which are resolved below a tick, so that a delay of one tick of 1 ms is noticed."""
TUBE_POINTS = 40
"""Number of points of a tube: more would make the file unreadable, and metrics judge the curve between them."""
TUBE_TIME = 0.004
"""Half width of a tube in time (s): two periods of the robot's controller."""
TUBE_FLOORS = {"m": 2.5e-5, "rad": 4e-4, "N": 0.05, "N m": 3e-3}
"""Minimum half width of a tube, by unit: one count of the joint encoder (2 pi / 16384, at a link of 60 mm), and the
force of one count of the motor encoder (2 pi / 4096 times k_s N at 60 mm)."""
STEP_TIME = 0.02
"""Time (s) that a reference needs for its step: one controller period for way points, another for a joint."""


@dataclass(frozen=True)
class Metric:
    """A measured number of a regression check, with its unit and default bound.

    Attributes:
        value: in `unit`, SI.
        floor: minimum of its bound.
        sense: direction of improvement: a smaller value, a value nearer to zero, or neither.
        scale: reference of the bound's share, in `unit`; None for the value itself, which is meaningless for a
            coordinate.
    """

    value: float
    unit: str
    floor: float
    sense: Sense = "less"
    scale: float | None = None

    @property
    def default_bound(self) -> float:
        """Default bound for a change of the number: 2 % of the value or scale, at least the floor."""
        return max(BOUND_SHARE * abs(self.value if self.scale is None else self.scale), self.floor)


def floor_of(unit: str) -> float:
    """Return the smallest bound for a number in `unit`; 0 if only a share of the value counts."""
    return UNIT_FLOORS.get(unit, 0.0)


@dataclass(frozen=True)
class Signals:
    """Signals of a completed run at every tick, by their names in [[measure]]; `fmus`: file name -> SHA-256."""

    run: Trace
    believed: Geometry
    fmus: dict[str, str] = field(default_factory=dict)

    @property
    def t(self) -> NDArray[np.float64]:
        """Times of the run's ticks (s), (n,)."""
        return self.run.t

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        """Return the values of a signal in the notation of [[measure]]: (n,), or (n, k) for k components."""
        vector, index = split_signal(signal.removeprefix("-"))
        values = self._theta_l if vector == REFERENCE_THETA_L else self.run.held(vector).astype(float, copy=False)
        values = values if index is None else values[:, index]
        return -values if signal.startswith("-") else values

    def unit(self, signal: str) -> str:
        vector, _ = split_signal(signal.removeprefix("-"))
        return "rad" if vector == REFERENCE_THETA_L else self.run.fields()[vector].unit

    @cached_property
    def _theta_l(self) -> NDArray[np.float64]:
        return joint_angles(self.believed, self["controller.p_ref_B"])


def split_signal(signal: str) -> tuple[str, int | None]:
    """Split a signal such as `plant.p_B[2]` into name and index; the index is None if missing."""
    vector, bracket, index = signal.partition("[")
    return vector, int(index.removesuffix("]")) if bracket else None


def run_for_measures(experiment: Experiment) -> Signals:
    run = Trace()
    with assemble(experiment) as assembly:
        refuse_unknown(experiment, assembly.system)
        done = simulate(assembly, experiment.duration_ticks, [run]).require_success()
        if trip := trip_reason(done.simulation):
            raise SafetyTrip(f"{experiment.name}: {trip}")
        return recorded_signals(experiment, run, assembly.drives, assembly.third_party)


def recorded_signals(
    experiment: Experiment, run: Trace, drives: Iterable[DrivePlan], third_party: Mapping[str, ThirdPartyPart]
) -> Signals:
    """Return the signals of a complete run with the hashes of its drives and third-party parts."""
    fmus = {fmu.path.name: fmu.sha256 for plan in drives for fmu in plan.parts.values()}
    fmus |= {part.label: part.sha256 for part in third_party.values()}
    return Signals(run, geometry_of(experiment.controller.model), fmus)


def refuse_unknown(experiment: Experiment, system: System) -> None:
    """Refuse a measure of an experiment that uses a signal which the system lacks."""
    fields = fields_of(system)
    sizes = {name: field.size for name, field in fields.items()}
    sizes[REFERENCE_THETA_L] = 3
    mistakes = []
    for number, measure in enumerate(experiment.measures, start=1):
        if isinstance(measure, RequirementMeasure):
            try:
                checked_requirement(measure.formula, fields)
            except InputRefused as problem:
                mistakes.append(f"[measure {number}] formula = {problem}")
        for key, signal in _signals(measure):
            vector, index = split_signal(signal.removeprefix("-"))
            entry = f'[measure {number}] {key} = "{signal}"'
            if vector not in sizes:
                mistakes.append(f"{entry}: no such signal; {nearest(vector, sizes, 'there are {}')}")
            elif (index is None) != (sizes[vector] == 1) or (index or 0) >= sizes[vector]:
                wanted = f"[0] to [{sizes[vector] - 1}]" if sizes[vector] > 1 else "no index"
                mistakes.append(f"{entry}: it has {sizes[vector]} components; expected {wanted}")
    if mistakes:
        raise InputRefused("\n".join(f"{experiment.name}: {mistake}" for mistake in mistakes))


def _signals(measure: Measure) -> list[tuple[str, str]]:
    """Return the (key, signal) pairs of a [[measure]] table; empty without "signal" and "reference"."""
    named = [("signal", measure.signal)] if isinstance(measure, SignalMeasure) else []
    return [*named, ("reference", measure.reference)] if isinstance(measure, ReferenceMeasure) else named


Metrics = dict[str, Metric]


@dataclass(frozen=True)
class SampledCurve:
    """A measured curve with the tolerance tube of a baseline.

    Attributes:
        t, values: (m,), s and SI.
        tolerance: half width of the tube in `unit`.
        dt: half width of the tube in time (s).
    """

    signal: str
    unit: str
    t: Curve
    values: Curve
    tolerance: float
    dt: float


@dataclass(frozen=True)
class Measurement:
    """All measures of an experiment with one drive: numbers and curves.

    Attributes:
        metrics: "measure.metric" -> number.
        curves: name of the measure -> curve with every tick of its window.
        fmus: file name -> SHA-256 of the FMUs.
    """

    metrics: Metrics
    curves: dict[str, SampledCurve]
    fmus: dict[str, str]


def measure_signals(experiment: Experiment, signals: Signals) -> Measurement:
    if not experiment.measures:
        raise InputRefused(f"{experiment.name}: has no [[measure]] tables to check; see docs/regression.md")
    metrics: Metrics = {}
    curves, mistakes = {}, []
    for measure in experiment.measures:
        try:
            metrics |= metrics_of_measure(measure, signals)
        except InputRefused as problem:
            mistakes.append(f'{experiment.name}: [[measure]] "{measure.name}": {problem}')
            continue
        if isinstance(measure, measures.Step | measures.Tracking):
            curves[measure.name] = _sample_curve(measure.signal, signals, _window_mask(measure, signals))
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return Measurement(metrics, curves, signals.fmus)


def metrics_of_measure(measure: measures.Measure, signals: Signals) -> Metrics:
    """Evaluate one measure of a run and return its numbers: "measure.metric" -> number."""
    inside = _window_mask(measure, signals)
    if np.count_nonzero(inside) < 2:
        raise InputRefused("fewer than two ticks from begin_s to until_s; measure for longer")
    found = MEASURE_FUNCTIONS[type(measure)](measure, signals, inside)
    # undefined numbers are left out: an endless oscillation may settle within 5 % but never within 2 %
    return {f"{measure.name}.{name}": metric for name, metric in found.items() if np.isfinite(metric.value)}


def _window_mask(measure: measures.Window, signals: Signals) -> NDArray[np.bool_]:
    return response.window_mask(signals.t, measure.begin, np.inf if measure.until is None else measure.until)


def _sample_curve(signal: str, signals: Signals, inside: NDArray[np.bool_]) -> SampledCurve:
    values, unit = signals[signal][inside], signals.unit(signal)
    tolerance = max(BOUND_SHARE * float(np.ptp(values)), TUBE_FLOORS.get(unit, 0.0))
    return SampledCurve(signal, unit, signals.t[inside], values, tolerance, TUBE_TIME)


def _step_metrics(measure: measures.Step, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    unit = _common_unit(measure, signals)
    reference, y = signals[measure.reference], signals[measure.signal][inside]
    first = int(np.argmax(inside))
    settled = reference[inside & (signals.t >= signals.t[first] + STEP_TIME)]
    if len(settled) == 0:
        raise InputRefused(f"measures for less than {STEP_TIME:g} s; expected the whole response")
    if np.ptp(settled) > _rounding_range(settled):
        raise InputRefused(f"{measure.reference} still moves after the step at {measure.begin:g} s; expected one step")
    if abs(settled[-1] - reference[max(0, first - 1)]) <= _rounding_range(settled):
        raise InputRefused(f"{measure.reference} makes no step at {measure.begin:g} s; set begin_s to when it does")
    before = signals[measure.signal][max(0, first - 1)]
    info = response.step_info(signals.t[inside] - signals.t[first], y, float(before), float(settled[-1]))
    step = abs(info.final - float(before))
    floor, length = floor_of(unit), float(signals.t[inside][-1] - signals.t[first])
    return {
        "delay_time": Metric(info.delay_time, "s", floor_of("s")),
        "rise_time": Metric(info.rise_time, "s", floor_of("s")),
        "settling_time_2": Metric(info.settling_time_2, "s", SETTLING_FLOOR),
        "settling_time_5": Metric(info.settling_time_5, "s", SETTLING_FLOOR),
        "overshoot": Metric(info.overshoot, "1", floor_of("1")),
        "peak": Metric(info.peak, unit, floor, "none", scale=step),
        # a tenth of the usual share of the step: smaller errors are as good as zero
        "steady_state_error": Metric(
            info.steady_state_error, unit, max(floor, 0.1 * BOUND_SHARE * step), "nearer zero"
        ),
        "IAE": Metric(info.IAE, f"{unit} s", floor * length),
        "ISE": Metric(info.ISE, f"{unit}2 s", 2.0 * floor * info.IAE),
        "ITAE": Metric(info.ITAE, f"{unit} s2", 0.5 * floor * length**2),
    }


def _tracking_metrics(measure: measures.Tracking, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    unit = _common_unit(measure, signals)
    error = (signals[measure.reference] - signals[measure.signal])[inside]
    return {
        "rms_error": Metric(response.rms(error), unit, floor_of(unit)),
        "max_error": Metric(float(np.max(np.abs(error))), unit, floor_of(unit)),
    }


def _lag_metrics(measure: measures.Lag, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    _common_unit(measure, signals)
    reference, y = signals[measure.reference][inside], signals[measure.signal][inside]
    for name, values in ((measure.reference, reference), (measure.signal, y)):
        if np.ptp(values) <= _rounding_range(values):
            raise InputRefused(f"{name} does not move, so it has no lag; measure while it does")
    t = signals.t[inside]
    found = response.lag(t, y, reference, measure.longest)
    if found >= measure.longest - (t[1] - t[0]):
        raise InputRefused(f"lags by longest_s = {measure.longest:g} or more; raise it, or it does not follow at all")
    late = t >= t[0] + found
    missed = response.rms(y[late] - np.interp(t[late] - found, t, reference))
    # quantised steps of a stepper drown its speed: the lag is then undefined
    return {"lag": Metric(found, "s", LAG_FLOOR, "nearer zero")} if missed < np.std(reference) else {}


def _spread_metrics(measure: measures.SpreadMeasure, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    unit, values = signals.unit(measure.signal), signals[measure.signal][inside]
    return {
        "mean": Metric(float(np.mean(values)), unit, floor_of(unit), "none"),
        "std": Metric(float(np.std(values)), unit, floor_of(unit)),
    }


def _oscillation_metrics(measure: measures.Oscillation, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    unit, t, values = signals.unit(measure.signal), signals.t[inside], signals[measure.signal][inside]
    length = float(t[-1] - t[0])
    if length * measure.lowest < response.MIN_PERIODS:
        raise InputRefused(
            f"measures for {length:g} s; expected {response.MIN_PERIODS} periods of lowest_Hz = {measure.lowest:g}, "
            f"which are {response.MIN_PERIODS / measure.lowest:g} s"
        )
    amplitude, frequency = response.strongest_swing(t, values, measure.lowest)
    found = {"amplitude": Metric(amplitude, unit, floor_of(unit))}
    # a constant signal has no frequency
    return found | (
        {"frequency": Metric(frequency, "Hz", 1.0 / length, "none")} if amplitude > _rounding_range(values) else {}
    )


def _onset_metrics(measure: measures.Onset, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    true = np.flatnonzero(signals[measure.signal][inside] > 0.0)
    if len(true) == 0:
        raise InputRefused(f"{measure.signal} is never true")
    return {"time": Metric(float(signals.t[inside][true[0]]), "s", floor_of("s"), "none")}


def _path_metrics(measure: measures.Path, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    path = signals["controller.p_ref_B"][inside]
    if np.all(np.ptp(path, axis=0) == 0.0):
        raise InputRefused("the reference does not move, so it has no path; measure while it does")
    error = response.path_error(signals["plant.p_B"][inside], path)
    return {
        "rms_error": Metric(response.rms(error), "m", floor_of("m")),
        "max_error": Metric(float(np.max(error)), "m", floor_of("m")),
    }


def _effort_metrics(measure: measures.Effort, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    t = signals.t[inside]
    omega_m = np.gradient(signals.run.of_drives("theta_m")[inside], t, axis=0)
    delivered, returned = response.work(t, signals["plant.tau_load"][inside], omega_m)
    return {
        "commanded_travel": Metric(response.travel(t, signals["controller.omega_ref"][inside]), "rad", floor_of("rad")),
        "work_delivered": Metric(delivered, "J", floor_of("J")),
        "work_returned": Metric(returned, "J", floor_of("J"), "none"),
    }


def _requirement_metrics(measure: measures.RequirementMeasure, signals: Signals, inside: NDArray[np.bool_]) -> Metrics:
    formula, unit = checked_requirement(measure.formula, signals.run.fields())
    left = distance(formula, signals.run.tick, lambda key: signals.run.held(key)[inside])
    return {"distance": Metric(left, unit, floor_of(unit), "none")}


def _rounding_range(values: Curve) -> float:
    """Return the largest range of values that counts as constant, because rounding explains it."""
    return 1e-9 * float(np.max(np.abs(values)))


def _common_unit(measure: measures.ReferenceMeasure, signals: Signals) -> str:
    unit, other = signals.unit(measure.signal), signals.unit(measure.reference)
    if unit != other:
        raise InputRefused(f"{measure.signal} is in {unit}, but its reference {measure.reference} in {other}")
    return unit


MEASURE_FUNCTIONS: dict[type[measures.Window], Callable[..., Metrics]] = {
    measures.Step: _step_metrics,
    measures.Tracking: _tracking_metrics,
    measures.Lag: _lag_metrics,
    measures.SpreadMeasure: _spread_metrics,
    measures.Oscillation: _oscillation_metrics,
    measures.Onset: _onset_metrics,
    measures.Path: _path_metrics,
    measures.Effort: _effort_metrics,
    measures.RequirementMeasure: _requirement_metrics,
}
