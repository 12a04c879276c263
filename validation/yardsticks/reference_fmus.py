"""The Modelica Association's Reference FMUs in the twin's master, beside the results that they carry."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from validation.yardstick import NotHere, Yardstick

FOLDER = "REFERENCE_FMUS"
MODELS = ("BouncingBall", "Dahlquist", "Feedthrough", "Stair", "VanDerPol")
SMALL = 1e-300


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
    from twin.studies.reference.outcome import BareRun, bare_run, carried, prepared

    off: dict[str, float] = {}
    for file in found(model):
        description = described(file)
        if description.version not in (2, 3) or description.kind != "co_simulation":
            continue
        for trial in carried(file).trials:
            files, runs = prepared(file, trial, description), list[BareRun]()
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


YARDSTICKS = tuple(
    Yardstick(
        f"{model}, FMI 2.0 and 3.0, default experiment: every number that its results have",
        "Reference FMUs, Modelica Association, built from their sources",
        "of the signal's range",
        1e-12,
        "the same code in the same steps: rounding, where another compiler made the results",
        partial(beside_its_results, model),
    )
    for model in MODELS
)
