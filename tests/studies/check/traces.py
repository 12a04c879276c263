"""Runs with known answers, and the shipped experiment with any measures."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.laws.runs import shipped
from tests.robot.run.made_up import made_up
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.measure import checked_measures
from twin.robot.mechanism.geometry import geometry_of
from twin.studies.check.measurement import Signals

t: NDArray[np.float64] = np.arange(10_001, dtype=np.float64) * 1e-3
EXPERIMENT = shipped("step_z_air")


def measuring(*tables: Mapping[str, Any]) -> Experiment:
    """The step in the air, with `tables` as its [[measure]]."""
    mistakes: list[str] = []
    measures = checked_measures(tuple(tables), float(t[-1]), mistakes)
    assert mistakes == []
    return replace(EXPERIMENT, measures=measures)


def trace(vectors: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> Signals:
    """Ten seconds at 1 ms of signals by name; a vector's are (n, k)."""
    return Signals(made_up(vectors, units), geometry_of(EXPERIMENT.controller.model), {"x.fmu": "0" * 64})
