"""The Modelica Association's Reference FMUs in the twin's master, beside the results that they carry."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from validation.joined import Curves, joined
from validation.yardstick import NotHere, Yardstick

FOLDER = "REFERENCE_FMUS"
MODELS = ("BouncingBall", "Dahlquist", "Feedthrough", "Stair", "VanDerPol")
SMALL = 1e-300
ME: Final = "model_exchange"


def found(model: str) -> list[Path]:
    """The FMUs of a model, of FMI 2.0 and 3.0, anywhere in the folder.

    Raises:
        NotHere: no folder is named in the environment, or it does not have them.
    """
    where = os.environ.get(FOLDER)
    if not where:
        raise NotHere(f"make validation {FOLDER}=a_folder with FMUs of modelica/Reference-FMUs")
    files = sorted(Path(where).rglob(f"{model}.fmu"))
    if not files:
        raise NotHere(f"{FOLDER} has no {model}.fmu")
    return files


def beside_its_results(model: str) -> Mapping[str, float]:
    """How far each signal is from the FMU's own results at their times, of its range."""
    from twin.kernel.fmi.description import described
    from twin.studies.reference.outcome import BareRun, bare_run, read_trial, reference_files

    off: dict[str, float] = {}
    for file in found(model):
        description = described(file)
        if description.version not in (2, 3) or description.kind != "co_simulation":
            continue
        for trial in reference_files(file).trials:
            files, runs = read_trial(file, trial, description), list[BareRun]()
            bare_run(description, trial, files, runs.append)
            run, results = runs[0], files.results
            assert results is not None
            # a run that the FMU ends has no row of the step in which it does
            t = results.t[results.t <= run.t[-1] + 1e-9]
            rows = np.round(t / run.step).astype(int)
            if len(results.t) - len(t) > 1 or np.abs(run.t[rows] - t).max() > 1e-9:
                raise RuntimeError(f"{file.name}: its results have other times than the run")
            for name in (name for name in results.signals if name in run.signals):
                theirs = results.signals[name][: len(t)]
                scale = max(float(np.ptp(theirs)), float(np.abs(theirs).max()), SMALL)
                difference = float(np.abs(run.signals[name][rows] - theirs).max())
                key = f"FMI {description.version}.0, {name}"
                off[key] = max(off.get(key, 0.0), difference / scale)
    return off


def exchanged(file: Path, t: np.ndarray, names: Sequence[str]) -> Curves:
    """Signals at the times `t` of an FMU for model exchange, the one component of a system: `twin cosim x.ssp`.

    Args:
        file: the FMU.
        t: evenly spaced, from 0 (s); what the FMU ends before is left out.
        names: of the signals.
    """
    from twin.kernel.systems.choice import MasterChoice

    stop = float(t[-1])
    # which is refused where the FMU is none for it
    choice = MasterChoice(tick=stop / (len(t) - 1), kinds={"model": ME})
    seen = [f"model.{name}" for name in names]
    return dict(zip(names, joined({"model": file}, choice, stop, seen).values(), strict=True))


def _exact(model: str, t: np.ndarray) -> Curves:
    """Solutions of their equations, with the parameters' start values."""
    if model == "Dahlquist":
        return {"x": np.exp(-t)}
    if model == "VanDerPol":
        from scipy.integrate import solve_ivp

        def rates(t: float, x: np.ndarray) -> list[float]:
            return [x[1], (1.0 - x[0] ** 2) * x[1] - x[0]]

        found = solve_ivp(rates, (0.0, t[-1]), [2.0, 0.0], "DOP853", t, rtol=1e-12, atol=1e-12)
        return {"x0": found.y[0], "x1": found.y[1]}
    g, e, begin, v, h = -9.81, 0.7, 0.0, 0.0, 1.0
    height, speed = np.zeros(len(t)), np.zeros(len(t))
    while v > 0.1 or begin == 0.0:
        lasts = (-v - np.sqrt(v * v - 2.0 * g * h)) / g
        now = (t >= begin) & (t < begin + lasts)
        since = t[now] - begin
        height[now], speed[now] = h + v * since + 0.5 * g * since**2, v + g * since
        begin, v, h = begin + lasts, -e * (v + g * lasts), 0.0
    return {"h": height, "v": speed}


def _off(own: Curves, other: Curves, rows: int) -> dict[str, float]:
    """The largest distance of each signal from the nearest of the other's that are at most so many `rows` away."""
    off = {}
    for name, theirs in other.items():
        count = min(len(theirs), len(own[name]))
        shifted = np.pad(theirs[:count], rows, mode="edge")
        near = [np.abs(own[name][:count] - shifted[k : k + count]) for k in range(2 * rows + 1)]
        scale = max(float(np.ptp(theirs)), float(np.abs(theirs).max()), SMALL)
        off[name] = float(np.min(near, axis=0).max()) / scale
    return off


def _each(model: str) -> Iterator[tuple[str, Path, np.ndarray, Curves]]:
    """Version of FMI, file, times and results of each FMU of a model that may be exchanged."""
    from twin.kernel.fmi.description import described
    from twin.studies.reference.outcome import read_trial, reference_files

    for file in found(model):
        if ME not in described(file).kinds or not (description := described(file, ME)).version > 1:
            continue
        for trial in reference_files(file).trials:
            results = read_trial(file, trial, description).results
            assert results is not None
            known = description.variables
            numbers = {name: one for name, one in results.signals.items() if name in known and known[name].kind >= 0}
            yield f"FMI {description.version}.0", file, results.t, numbers


def exchanged_beside_results(model: str) -> Mapping[str, float]:
    """How far each signal is from the FMU's own results at most a step away, of its range."""
    off: dict[str, float] = {}
    for version, file, t, results in _each(model):
        off |= {f"{version}, {name}": value for name, value in _off(exchanged(file, t, [*results]), results, 1).items()}
    return off


def exchanged_beside_exact(model: str) -> Mapping[str, float]:
    """The same, from the solution of its equations at the same time."""
    off: dict[str, float] = {}
    for version, file, t, _ in _each(model):
        exact = _exact(model, t)
        off |= {f"{version}, {name}": value for name, value in _off(exchanged(file, t, [*exact]), exact, 0).items()}
    return off


EULER = {"BouncingBall": 0.316, "Dahlquist": 0.0193, "VanDerPol": 0.1102}
"""How far forward Euler is from the exact solutions, of which the results are, of a signal's range."""
EVENTS = ("Feedthrough", "Resource", "Stair")
MADE, UNIT = "Reference FMUs, Modelica Association, built from their sources", "of the signal's range"
IN_A_SYSTEM = "FMI 2.0 and 3.0, as model exchange in an SSP"
COMPARISONS: tuple[tuple[Mapping[str, float], str, str, Callable[[str], Mapping[str, float]]], ...] = (
    (
        dict.fromkeys(MODELS, 1e-12),
        "FMI 2.0 and 3.0, default experiment: every number that its results have",
        "the same code in the same steps: rounding, where another compiler made the results",
        beside_its_results,
    ),
    (
        dict.fromkeys(EULER, 2e-4),
        f"{IN_A_SYSTEM}: every number beside the exact solution",
        "CVODE at its usual relative tolerance of 1e-6; speeds jump at a bounce, whose time is found as exactly",
        exchanged_beside_exact,
    ),
    (
        EULER,
        f"{IN_A_SYSTEM}: every number that its results have, at most a step away",
        "the results are of co-simulation by forward Euler, and as far from the exact solution",
        exchanged_beside_results,
    ),
    (
        dict.fromkeys(EVENTS, 0.0),
        f"{IN_A_SYSTEM}: every number that its results have, at most a step away",
        "the same numbers; an event at the time of a row is in the results, and in the next row here",
        exchanged_beside_results,
    ),
)
"""Bounds by model, what is compared, why that bound, and what works it out."""
YARDSTICKS = tuple(
    Yardstick(f"{model}, {claim}", MADE, UNIT, bound, reason, partial(compare, model))
    for bounds, claim, reason, compare in COMPARISONS
    for model, bound in bounds.items()
)
