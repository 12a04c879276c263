"""An FMU run by itself, and whether it does what results say: signals by name, no drive contract and no robot."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from twin.cosim.port import Port
from twin.cosim.signals import playback
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.drive.component import ExchangeComponent, FmuComponent
from twin.drive.description import FmuDescription
from twin.drive.setting import Setup
from twin.drive.solvers import Solver
from twin.drive.stepping import FmuPort
from twin.drive.unpacked import unpacked
from twin.drive.variable import Variable
from twin.errors import ComponentFailed, InputRefused
from twin.studies.metrics.response import Curve
from twin.studies.reference.carried import Prepared, Trial
from twin.studies.reference.series import Series

STEPS = 500
"""Of an experiment for which nobody states a step: what FMPy and others take."""
MOST_STEPS = 2_000_000
MOST_VALUES = 20_000_000
"""Of all outputs over all steps: 160 MB."""
OF_RANGE = 0.01
OF_SIZE = 1e-4
"""For signals that hardly move: results are often written with six digits."""
LEAST = 1e-9
TOLERANCE = (
    f"{100 * OF_RANGE:g} % of a signal's range in the results, at some moment within one step of that of the result: "
    "a tolerance of ours, the files state none"
)
"""One step, because inputs are held over it and a jump is seen at its end."""
EXACT = 2.0**53
"""Whole numbers from here on do not fit the doubles that travel between components."""


@dataclass(frozen=True)
class BareRun:
    """Attributes:
    step: between two rows (s).
    t: s, (rows,).
    signals: by name, in the FMU's own units, of an array the first value, (rows,).
    unknown: names that were asked for and are no single number of this FMU.
    failure: what ended it before its time; "" if nothing did.
    """

    step: float
    t: Curve
    signals: dict[str, Curve]
    unknown: tuple[str, ...]
    failure: str = ""


def bare_run(description: FmuDescription, trial: Trial, files: Prepared, ended: Callable[[BareRun], None]) -> None:
    """Run the FMU as an experiment describes it; what that does not say is the FMU's default experiment.

    Args:
        description: the FMU.
        trial: the experiment.
        files: what it is told, and its results.
        ended: told of the run before the FMU is freed, in which some crash.

    Raises:
        InputRefused: a step, duration or input that cannot be.
        ComponentFailed: the FMU cannot be loaded or initialised.
    """
    step, last = _steps(description, trial, files.results)
    outputs, unknown = _watched(description, files.results)
    if (last + 1) * (values := sum(p.port.size for p in outputs)) > MOST_VALUES:
        raise InputRefused(f"{description.path.name}: {last} steps of {values} signals; expected fewer")
    inputs = _inputs(description, files.stimuli)
    stimuli = _sampled(inputs, files.stimuli, step * np.arange(last + 1, dtype=float))
    start = dict(zip((p.port.name for p in inputs), stimuli[0], strict=True))
    setup = Setup(trial.tolerance or description.tolerance, step * last, step)
    set_ = description.settings(files.parameters)
    folder = unpacked(description.path, description.sha256)
    try:
        component = _component(description)("fmu", description, folder, inputs, outputs, set_, start, setup=setup)
    except InputRefused as refusal:
        raise ComponentFailed(str(refusal)) from None
    try:
        wires = [(f"signals.{p.port.name}", f"fmu.{p.port.name}") for p in inputs]
        signals = [playback(tuple(p.port for p in inputs), stimuli)] if inputs else []
        system = System([*signals, component], wires, step)
        simulation = Simulation(system, last)
        slices = []
        while not simulation.finished:
            slices.append(simulation.advance().copy())
        rows = np.concatenate(slices)
        columns = {p.variable.name: system.columns(f"fmu.{p.port.name}").start for p in outputs}
        failure = str(simulation.failure) if simulation.failure else ""
        names = {name: rows[:, column] for name, column in columns.items()}
        ended(BareRun(step, step * np.arange(len(rows), dtype=float), names, unknown, failure))
    finally:
        component.close()


def _component(description: FmuDescription) -> Callable[..., FmuComponent]:
    """What is made of an FMU of this kind; one for model exchange gets CVODE."""
    if description.kind == "co_simulation":
        return FmuComponent
    return partial(ExchangeComponent, solver=Solver())


def _steps(description: FmuDescription, trial: Trial, results: Series | None) -> tuple[float, int]:
    """Step (s) and how many of them."""
    stated = description.model.defaultExperiment
    start = _first(trial.start, getattr(stated, "startTime", None)) or 0.0
    # where nobody states an end: as the results, or as FMPy
    end = 1.0 if results is None else float(results.t[-1])
    stop = trial.stop if trial.stop is not None else _first(getattr(stated, "stopTime", None)) or end
    if start != 0.0:
        raise InputRefused(f"{trial.name}: starts at {start:g} s; expected 0 s, where runs begin here")
    own = getattr(description.interface, "fixedInternalStepSize", None)
    step = _first(own, getattr(stated, "stepSize", None)) or stop / STEPS if trial.step is None else trial.step
    if not (0.0 < step <= stop and stop / step <= MOST_STEPS):
        raise InputRefused(f"{trial.name}: steps of {step:g} s until {stop:g} s; expected 1 to {MOST_STEPS} of them")
    return step, math.floor(stop / step + 1e-9)


def _first(*stated: object) -> float | None:
    """The first number among them."""
    for value in stated:
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            continue
        if math.isfinite(number):
            return number
    return None


def _watched(description: FmuDescription, results: Series | None) -> tuple[list[FmuPort], tuple[str, ...]]:
    """Ports of what results are given of, or else of all outputs, of a local variable, of any; and what is none."""
    numbers = {v.name: v for v in description.variables.values() if v.kind >= 0}
    asked = () if results is None else (*results.signals, *results.others)
    unknown = tuple(name for name in asked if name not in numbers or numbers[name].size > 1)
    chosen = [numbers[name] for name in results.signals if name not in unknown] if results else []
    chosen = chosen or [v for v in numbers.values() if v.causality == "output"]
    chosen = chosen or [v for v in numbers.values() if v.causality == "local"][:1] or list(numbers.values())[:1]
    if not chosen:
        raise InputRefused(f"{description.path.name}: has no variable that is a number")
    return _ports("y", chosen), unknown


def _inputs(description: FmuDescription, stimuli: Series | None) -> list[FmuPort]:
    if stimuli is None:
        return []
    offered = {v.name: v for v in description.offered("input") if v.size == 1}
    for name in (*stimuli.signals, *stimuli.others):
        if name not in offered or name in stimuli.others:
            raise InputRefused(f"{stimuli.where}: column '{name}' is no input of numbers of {description.path.name}")
        if np.abs(stimuli.signals[name]).max() >= EXACT and not _continuous(offered[name]):
            raise InputRefused(f"{stimuli.where}: column '{name}' has whole numbers of more than 53 bits")
    return _ports("u", [offered[name] for name in stimuli.signals])


def _ports(letter: str, variables: list[Variable]) -> list[FmuPort]:
    """Names of FMU variables may hold any character, those of ports stand in wires."""
    return [FmuPort(Port(f"{letter}{n}", v.size, v.unit or "1"), v) for n, v in enumerate(variables)]


def _sampled(inputs: list[FmuPort], stimuli: Series | None, t: Curve) -> np.ndarray:
    """Inputs at the times `t`, (times, inputs): of numbers on lines, of whole numbers the last."""
    if stimuli is None:
        return np.zeros((len(t), 0))
    columns = [(stimuli.linear if _continuous(p.variable) else stimuli.held)(p.variable.name, t) for p in inputs]
    return np.column_stack(columns)


def _continuous(variable: Variable) -> bool:
    return variable.type in ("Real", "Float64", "Float32")


class Deviation(NamedTuple):
    """Of a signal: how far it leaves the results at most, in multiples of the tolerance, and when (s)."""

    signal: str
    share: float
    t: float


def deviations(run: BareRun, results: Series) -> list[Deviation]:
    """Every signal of a run that the results have, in their order."""
    within = results.t <= (1.0 + 1e-9) * run.t[-1]
    t = results.t[within]
    if not len(t):
        return []
    place = np.floor(t / run.step + 1e-6).astype(int)
    near = np.clip(place[:, None] + np.array([-1, 0, 1, 2]), 0, len(run.t) - 1)
    found = []
    for name, ours in run.signals.items():
        if name not in results.signals:
            continue
        theirs = results.signals[name][within]
        band = max(OF_RANGE * np.ptp(theirs), OF_SIZE * np.abs(theirs).max(), LEAST)
        low, high = ours[near].min(axis=1), ours[near].max(axis=1)
        beyond = np.maximum(np.maximum(low - theirs, theirs - high), 0.0) / band
        worst = int(np.argmax(beyond))
        found.append(Deviation(name, float(beyond[worst]), float(t[worst])))
    return found
