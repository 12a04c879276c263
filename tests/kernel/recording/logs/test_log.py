from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.recording.logs.log import Log, LogError, LogSeries, in_gap, sampling


@given(st.sets(st.integers(1, 198), max_size=40))
def test_dropped_samples_of_a_clock_are_counted(dropped: set[int]):
    t = np.array([0.01 * k for k in range(200) if k not in dropped])
    found = sampling(t)
    assert found.missing == len(dropped)
    assert np.sum(found.gaps[:, 1] - found.gaps[:, 0] - 0.01) < 0.01 * len(dropped) + 1e-9  # round-off of t
    inside = in_gap(np.array([0.01 * k for k in sorted(dropped)]), found.gaps)
    assert np.all(inside)
    assert not np.any(in_gap(t, found.gaps))


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
    with pytest.raises(LogError, match=expected):
        log.vector("p")


def test_a_name_that_is_not_there_is_refused_with_the_nearest():
    with pytest.raises(LogError, match=r"'controller.Fz' is not there; did you mean 'controller.F_z'\?"):
        log_of(**{"controller.F_z": "N"})["controller.Fz"]


def test_the_note_says_how_many_how_long_and_where():
    t = np.delete(np.arange(100) * 0.1, [10, 50, 51])
    assert sampling(t).note == "3 samples missing in 2 gaps, the longest 0.3 s at 4.9 s"
    assert sampling(np.delete(np.arange(10) * 0.1, [5])).note == "1 sample missing in a gap of 0.2 s at 0.4 s"
    assert sampling(np.arange(10.0)).note == ""


def test_a_clock_that_jitters_loses_nothing():
    jitter = np.random.default_rng(1).uniform(-0.2, 0.2, 1000)
    assert sampling(np.arange(1000.0) + jitter).missing == 0


def test_points_without_a_clock_have_no_gaps():
    t = np.cumsum(np.random.default_rng(1).exponential(1.0, 500))
    found = sampling(t)
    assert not found.regular
    assert len(found.gaps) == 0
