from pathlib import Path

import numpy as np
import pytest

from twin.recording.logs.errors import LogRefused
from twin.recording.logs.log import Log, LogSeries

T = np.array([0.0, 1.0])


def log_of(**units: str) -> Log:
    return Log(Path("a.csv"), {name: LogSeries(T, T, unit) for name, unit in units.items()})


def three(units: tuple[str, str, str] = ("m", "m", "m")) -> Log:
    return Log(Path("a.csv"), {f"p[{i}]": LogSeries(T, i + T, unit) for i, unit in enumerate(units)})


def test_components_make_a_vector():
    p = three().vector("p")
    assert p.values.tolist() == [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]]
    assert p.unit == "m"


@pytest.mark.parametrize(
    ("log", "expected"),
    [
        (log_of(q="m"), r"a.csv: 'p\[0\]' is not there; it has q"),
        (three(("m", "m", "rad")), "differ in unit or in times"),
        (Log(Path("a.csv"), {"p[0]": LogSeries(T, T, "m"), "p[2]": LogSeries(T, T, "m")}), r"has components \[0, 2\]"),
    ],
)
def test_a_vector_needs_all_its_components_alike(log: Log, expected: str):
    with pytest.raises(LogRefused, match=expected):
        log.vector("p")


def test_a_name_that_is_not_there_is_refused_with_the_nearest():
    with pytest.raises(LogRefused, match=r"'controller.Fz' is not there; did you mean 'controller.F_z'\?"):
        log_of(**{"controller.F_z": "N"})["controller.Fz"]
