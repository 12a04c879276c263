from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.conftest import examples
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import require_unit
from twin.studies.compare.tolerance import (
    Allowance,
    alignment,
    allowance,
    matches,
    reach,
    rules,
    time_shift,
)

from .logs import log_of

N, M = require_unit("N", ""), require_unit("m", "")


def allowed(signal: str, *texts: str, of=N, span: float = 10.0) -> Allowance:
    return allowance(signal, of, span, 0.0, rules(texts))


def test_without_rules_two_percent_of_the_range_and_two_controller_periods_are_allowed():
    assert allowed("controller.F_z") == Allowance(0.2, 0.004)


def test_numbers_of_ten_digits_are_equal_to_those_they_were():
    assert allowance("F", N, 0.0, 5.0, ()).value == 5e-9


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["1%"], Allowance(0.1, 0.004)),
        (["1 % @ 10 ms"], Allowance(0.1, 0.01)),
        (["@0s"], Allowance(0.2, 0.0)),
        (["controller.F_z=50mN"], Allowance(0.05, 0.004)),
        (["controller.*=0.05 N @ 1 ms"], Allowance(0.05, 0.001)),
        (["1%", "controller.F_z=0.05N"], Allowance(0.05, 0.004)),
        (["controller.F_z=0.05N", "1%"], Allowance(0.1, 0.004)),
        (["plant.*=1N"], Allowance(0.2, 0.004)),
        (["*=1mm@1ms"], Allowance(0.2, 0.001)),
    ],
)
def test_the_last_rule_that_says_something_wins(texts: list[str], expected: Allowance):
    assert allowed("controller.F_z", *texts) == expected


def test_file_and_command_line_say_the_same(tmp_path: Path):
    file = tmp_path / "tol.toml"
    file.write_text('"*" = "1 % @ 10 ms"\ncontroller.F_z = "0.05 N"\n"plant.p_B[2]" = "0.1 mm"\n')
    texts = ["*=1%@10ms", "controller.F_z=0.05N", "plant.p_B[2]=0.1mm"]
    assert rules([str(file)]) == rules(texts)


@pytest.mark.parametrize(
    ("pattern", "signal", "fits"),
    [
        ("plant.p_B", "plant.p_B[2]", True),
        ("plant.p_B[2]", "plant.p_B[2]", True),
        ("plant.p_B[1]", "plant.p_B[2]", False),
        ("*.F_z", "controller.F_z", True),
        ("drive/?.omega_m", "drive/2.omega_m", True),
        ("controller.F", "controller.F_z", False),
    ],
)
def test_a_pattern_fits_components_and_brackets_are_indices(pattern: str, signal: str, fits: bool):
    assert matches(pattern, signal) is fits


@pytest.mark.parametrize("text", ["", "F=", "F=x", "F=-1N", "F=1Nx", "F=1N@1N", "F=1N@", "F=1e999N", "=1N"])
def test_what_is_no_rule_is_refused(text: str):
    with pytest.raises(InputRefused, match="--tol"):
        rules([text])


def test_every_mistake_of_a_file_is_told_with_its_place(tmp_path: Path):
    file = tmp_path / "tol.toml"
    file.write_text('F = "x"\nG = 3\n')
    with pytest.raises(InputRefused) as refused:
        rules([file, "nowhere.toml"])
    assert [line.partition(":")[0] for line in str(refused.value).splitlines()] == [
        str(file),
        str(file),
        "--tol nowhere.toml",
    ]


def test_a_tolerance_of_another_dimension_is_refused_where_the_signal_is_named():
    with pytest.raises(InputRefused, match=r"tolerance of controller\.F_z is in m, but it is in N"):
        allowed("controller.F_z", "controller.F_z=1mm")


VALUES = st.floats(-10.0, 10.0)
STEPS = st.floats(0.01, 1.0)
# interpolation and shifted stamps round: a few ulps of 10, steepest slope 20/0.01
ROUND = 1e-10


@st.composite
def polygons(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    n = draw(st.integers(2, 30))
    t = np.cumsum(draw(arrays(float, n, elements=STEPS)))
    return t, draw(arrays(float, n, elements=VALUES))


@given(polygons(), st.floats(0.0, 3.0), st.floats(-1.0, 1.0))
def test_a_copy_shifted_by_no_more_than_dt_is_inside_without_any_tolerance(
    polygon: tuple[np.ndarray, np.ndarray], dt: float, part: float
):
    t, values = polygon
    at = t[(t + part * dt >= t[0]) & (t + part * dt <= t[-1])]
    shifted = np.interp(at, t - part * dt, values)
    assert np.all(np.abs(reach(t, values, at, dt).excess(shifted)) <= ROUND)


@given(polygons(), st.floats(0.0, 3.0), st.floats(0.0, 5.0), st.floats(1e-3, 5.0))
def test_whatever_is_above_all_values_by_more_than_the_tolerance_is_outside_by_the_rest(
    polygon: tuple[np.ndarray, np.ndarray], dt: float, tolerance: float, more: float
):
    t, values = polygon
    tube = reach(t, values, t, dt).widen(tolerance)
    high, low = np.full(len(t), values.max() + tolerance + more), np.full(len(t), values.min() - tolerance - more)
    assert np.all(tube.excess(high) >= more - ROUND)
    assert np.all(tube.excess(low) <= -more + ROUND)


@given(polygons(), st.floats(0.0, 3.0))
def test_the_reach_is_the_least_and_the_largest_of_the_polygon_in_the_window(
    polygon: tuple[np.ndarray, np.ndarray], dt: float
):
    t, values = polygon
    at = np.linspace(t[0], t[-1], 7)
    found = reach(t, values, at, dt)
    for k, time in enumerate(at):
        ends = np.clip([time - dt, time + dt], t[0], t[-1])
        inside = np.concatenate([np.interp(ends, t, values), values[(t >= ends[0]) & (t <= ends[1])]])
        assert found.lower[k] == inside.min()
        assert found.upper[k] == inside.max()


@given(polygons(), st.floats(0.0, 3.0))
def test_up_and_down_are_alike(polygon: tuple[np.ndarray, np.ndarray], dt: float):
    t, values = polygon
    up, down = reach(t, values, t, dt), reach(t, -values, t, dt)
    np.testing.assert_array_equal(up.lower, -down.upper)
    np.testing.assert_array_equal(up.upper, -down.lower)


@examples(30)
@given(polygons(), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_wider_window_reaches_no_less(polygon: tuple[np.ndarray, np.ndarray], dt: float, more: float):
    t, values = polygon
    narrow, wide = reach(t, values, t, dt), reach(t, values, t, dt + more)
    assert np.all(wide.lower <= narrow.lower + ROUND)
    assert np.all(wide.upper >= narrow.upper - ROUND)


def test_what_is_not_a_number_is_outside():
    t = np.array([0.0, 1.0])
    assert reach(t, t, t, 0.0).widen(9.0).excess(np.array([0.0, np.nan])).tolist() == [0.0, np.inf]


T = np.arange(0.0, 10.0, 0.01)


def bump(t: np.ndarray) -> np.ndarray:
    return np.exp(-((t - 4.0) ** 2))


@examples(20)
@given(st.floats(-0.9, 0.9))
def test_a_fit_finds_the_shift_between_two_samplings_of_one_curve(delay: float):
    found = time_shift(log_of(T, F=bump(T)), log_of(T + 0.003, F=bump(T + 0.003 - delay)), alignment("fit", "F"))
    # chords of 10 ms are off by f'' h^2/8 = 2.5e-5, the curve rises by up to 0.86 per s
    assert found.seconds == pytest.approx(-delay, abs=1e-4)
    assert found.note == ""


def test_a_fit_at_its_bound_says_so():
    found = time_shift(log_of(T, F=bump(T)), log_of(T, F=bump(T - 1.0)), alignment("fit", "F", 0.5))
    assert found.seconds == pytest.approx(-0.5, abs=1e-3)  # the grid's last point
    assert "widen it" in found.note


def test_starts_are_aligned_by_the_first_samples():
    assert time_shift(log_of(T, F=T), log_of(T + 1.7e3, F=T), alignment("start")).seconds == -1.7e3


def test_events_are_aligned_where_the_signal_crosses_the_middle_of_the_range():
    step = np.where(T > 3.0, 1.0, 0.0)
    found = time_shift(log_of(T, on=step), log_of(T, on=np.where(T > 5.0, 1.0, 0.0)), alignment("event", "on"))
    assert found.seconds == pytest.approx(-2.0, abs=1e-9)  # round-off of the times


@pytest.mark.parametrize(
    ("kind", "signal", "max_shift", "expected"),
    [
        ("middle", "", 1.0, "--align middle: expected one of none, start, event, fit"),
        ("fit", "", 1.0, "--align fit: expected a signal"),
        ("fit", "F", 0.0, "--max-shift 0: expected a time > 0 s"),
    ],
)
def test_an_alignment_that_says_too_little_is_refused(kind: str, signal: str, max_shift: float, expected: str):
    with pytest.raises(InputRefused, match=expected):
        alignment(kind, signal, max_shift)


def test_a_signal_that_shows_nothing_is_refused():
    flat, low = log_of(T, F=np.ones_like(T)), log_of(T, F=0.1 * bump(T))
    with pytest.raises(InputRefused, match="is constant"):
        time_shift(log_of(T, F=bump(T)), flat, alignment("fit", "F"))
    with pytest.raises(InputRefused, match=r"F never crosses 0\.5"):
        time_shift(log_of(T, F=bump(T)), low, alignment("event", "F"))
    with pytest.raises(InputRefused, match="overlap by less than half"):
        time_shift(log_of(T, F=bump(T)), log_of(T + 50.0, F=bump(T)), alignment("fit", "F"))
