"""What differs in the experiments of two runs is what was made to differ."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.log import Log, LogSeries
from twin.kernel.recording.reader import Recording
from twin.kernel.serialise import to_dict
from twin.studies.compare.comparison import Comparison, compare_logs, experiments_differ
from twin.studies.compare.signal_row import coverage
from twin.studies.compare.text import differences_lines
from twin.studies.compare.tolerance import alignment, rules

from .logs import log_of


def test_two_runs_say_what_differs_in_their_experiments(force_position: Recording, position: Recording, tmp_path: Path):
    done = twin("compare", force_position.path, position.path, "--signal", "plant.p_B", cwd=tmp_path)
    lines = done.stdout.splitlines()
    place = lines.index("Differences of the experiments, A and B:")
    assert lines[place + 1 : place + 2] == ["  controller.mode  force_position and position"]
    assert max(map(len, lines[place:-2])) <= 80


def test_the_same_experiment_differs_in_nothing(force_position: Recording):
    differ = experiments_differ(force_position.path, force_position.path)
    assert differ == {} and differences_lines(differ) == ["", "Nothing differs in the experiments."]


def test_a_log_of_somebody_else_says_of_no_experiment(force_position: Recording, tmp_path: Path):
    (tmp_path / "log.csv").write_text("t\n0\n")
    assert experiments_differ(force_position.path, tmp_path / "log.csv") is None
    assert differences_lines(None) == []


T = np.arange(0.0, 10.0, 0.001)
SPEED = 2.0 * np.pi


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two different files for logs made of arrays."""
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("a")
    Path("b.csv").write_text("b")


pytestmark = pytest.mark.usefixtures("files")


def against(a: Log, b: Log, *texts: str, **others) -> Comparison:
    return compare_logs(a, replace(b, path=Path("b.csv")), rules(texts), **others)


def test_errors_of_a_late_sine_are_those_of_the_formula():
    """sin(w (t - d)) - sin(w t) = -2 sin(w d/2) cos(w (t - d/2)): amplitude 2 sin(w d/2), rms over sqrt 2."""
    delay = 0.02
    row = against(log_of(T, F=np.sin(SPEED * T)), log_of(T, F=np.sin(SPEED * (T - delay)))).rows[0]
    amplitude = 2.0 * np.sin(SPEED * delay / 2.0)
    assert row.max_error == pytest.approx(amplitude, rel=1e-5)  # 1 ms samples miss the peak by up to (w/2 1 ms)^2/2
    assert row.rms_error == pytest.approx(amplitude / np.sqrt(2.0), rel=1e-9)  # whole periods
    assert row.mean_error == pytest.approx(0.0, abs=1e-12)
    assert (row.n, row.covered, row.span) == (len(T), 1.0, 2.0)


def test_a_delay_is_inside_when_time_allows_it_and_outside_when_not():
    # not from the very start, where the reference would have to be known earlier
    within = T[50:-50]
    a, b = log_of(T, F=np.sin(SPEED * T)), log_of(within, F=np.sin(SPEED * (within - 0.02)))
    assert not against(a, b, "0.1%@20ms").outside_rows
    assert against(a, b, "0.1%@19ms").outside_rows


def test_a_value_is_inside_up_to_the_tolerance_and_named_from_the_first_beyond():
    b = np.where(T < 5.0, 0.09, 0.11)
    found = against(log_of(T, F=np.zeros_like(T)), log_of(T, F=b), "F=0.1N@0s")
    row = found.rows[0]
    assert row.first_exit is not None
    assert (row.first_exit.t, row.first_exit.value, row.first_exit.upper) == (5.0, 0.11, 0.1)
    assert row.outside == np.sum(T >= 5.0)
    assert row.used == pytest.approx(1.1, rel=1e-12)  # one division


def test_the_first_to_leave_is_the_first_outside_and_rows_are_worst_first():
    b = {"late": np.where(T > 8.0, 5.0, 0.0), "early": np.where(T > 2.0, 1.0, 0.0), "never": 0.0 * T}
    found = against(log_of(T, late=0.0 * T, early=0.0 * T, never=0.0 * T), log_of(T, b), "0.5N")
    assert [row.signal for row in found.rows] == ["late", "early", "never"]
    assert [row.signal for row in found.outside_rows] == ["early", "late"]


def test_what_is_sampled_more_sparsely_sets_the_instants():
    coarse = T[::100]
    a, b = log_of(T, F=np.sin(SPEED * T)), log_of(coarse, F=np.sin(SPEED * coarse))
    for first, second in ((a, b), (b, a)):
        row = against(first, second).rows[0]
        assert row.n == len(coarse)
        assert row.max_error < 1e-12  # both hold the same numbers there


def test_a_gap_of_dropped_samples_is_left_out_rather_than_bridged():
    kept = (T < 4.2) | (T > 4.3)
    a, b = log_of(T, F=np.sin(SPEED * T)), log_of(T[kept], F=np.sin(SPEED * T[kept]))
    row = against(a, b).rows[0]
    assert (row.outside, row.n) == (0, int(np.sum(kept)))
    assert row.max_error == 0.0
    assert row.covered == pytest.approx(0.99, abs=3e-4)  # the gap is 0.1 s and one period of 10 s


def test_instants_in_a_gap_of_the_denser_log_are_left_out():
    kept = (T < 4.2) | (T > 4.3)
    coarse = T[::50]
    a, b = log_of(coarse, F=np.sin(SPEED * coarse)), log_of(T[kept], F=np.sin(SPEED * T[kept]))
    for first, second in ((a, b), (b, a)):
        row = against(first, second).rows[0]
        assert row.n == len(coarse) - np.sum((coarse >= 4.2) & (coarse <= 4.3))
        assert row.max_error < 1e-12  # both hold the same numbers there


def covered(ours: np.ndarray, theirs: np.ndarray) -> float:
    return coverage(LogSeries(ours, ours, "s"), LogSeries(theirs, theirs, "s"))


def test_a_log_of_the_same_time_covers_all_of_it_whatever_its_clock():
    for period in (0.001, 0.01, 0.3):
        for phase in (0.0, 0.4, 0.999):
            other = np.arange(phase * period, T[-1], period)
            assert covered(T, other) == 1.0
            assert covered(other, T) == 1.0


def test_what_is_cut_off_is_not_covered_from_the_second_period_on():
    period = T[1] - T[0]
    assert covered(T, T[1:-1]) == 1.0
    assert covered(T, T[2:]) == pytest.approx(1.0 - 2.0 * period / T[-1])
    assert covered(T, T[:-2]) == pytest.approx(1.0 - 2.0 * period / T[-1])
    assert covered(T, T[: len(T) // 100]) == pytest.approx(0.01, abs=2e-4)
    assert covered(T[: len(T) // 100], T) == 1.0


def test_one_lost_sample_is_no_hole_and_two_in_a_row_are():
    assert covered(T, np.delete(T, [50, 120, 121 + 40])) == 1.0
    lost = covered(T, np.delete(T, [50, 51]))
    assert lost == pytest.approx(1.0 - 3.0 * (T[1] - T[0]) / T[-1])


def test_a_hole_in_both_is_missing_in_neither():
    kept = T[(T < 4.2) | (T > 4.8)]
    wider = T[(T < 4.1) | (T > 4.9)]
    assert covered(kept, kept) == 1.0
    assert covered(wider, kept) == 1.0
    assert covered(kept, wider) == pytest.approx(1.0 - 0.2 / 9.4, abs=5e-4)


def test_only_what_both_cover_is_compared():
    half = T[T < 5.0]
    found = against(log_of(T, F=T), log_of(half, F=half))
    row = found.rows[0]
    assert found.least_coverage == ("F", row.covered)
    assert row.n == len(half)
    assert row.covered == pytest.approx(0.5, abs=2e-4)  # a period


def test_a_component_that_is_only_noise_is_measured_by_its_vector():
    noise = 1e-15 * np.sin(T)
    a = {"F[0]": noise, "F[1]": 5.0 * np.sin(T), "F[2]": noise}
    assert not against(log_of(T, a), log_of(T, {**a, "F[0]": -noise, "F[2]": -noise})).outside_rows


def test_a_shift_that_was_found_is_told_and_undone():
    a, b = log_of(T, F=np.sin(SPEED * T)), log_of(T + 100.0, F=np.sin(SPEED * T))
    found = against(a, b, how=alignment("start"))
    assert found.shift.seconds == -100.0
    assert not found.outside_rows


def test_a_value_that_is_not_a_number_is_outside_and_the_facts_are_json():
    b = np.zeros_like(T)
    b[7] = np.nan
    found = against(log_of(T, F=np.sin(T)), log_of(T, F=np.sin(T) + b))
    assert [row.first_exit.t for row in found.outside_rows if row.first_exit] == [T[7]]
    assert json.loads(json.dumps(to_dict(found), allow_nan=False))["rows"][0]["max_error"] is None


def test_the_same_bytes_are_identical():
    Path("b.csv").write_text("a")
    assert against(log_of(T, F=T), log_of(T, F=T)).identical


def test_signals_can_be_chosen_and_the_others_are_listed():
    a, b = log_of(T, {"p[0]": T, "p[1]": T, "F": T}), log_of(T, {"p[0]": T, "p[1]": T, "G": T, "F": T})
    found = against(a, b, signals=["p"])
    assert {row.signal for row in found.rows} == {"p[0]", "p[1]"}
    assert (found.only_a, found.only_b) == ((), ("G",))


def test_units_of_one_dimension_are_one_and_others_are_refused_with_the_remedy():
    t = T[:3]
    a = log_of(t, F=t, p=t)
    b = Log(Path("b.csv"), {"F": LogSeries(t, t, "1"), "p": LogSeries(t, t, "m")})
    with pytest.raises(InputRefused) as refused:
        compare_logs(a, b)
    assert str(refused.value) == (
        "F is in N in a.csv but in 1 in b.csv; b.csv states no unit; --map F=COLUMN[UNIT]\n"
        "p is in N in a.csv but in m in b.csv; correct it with --map"
    )


@pytest.mark.parametrize(
    ("b", "others", "expected"),
    [
        ({"G": T}, {}, "no signal in common: a.csv has F; b.csv has G; name them with --map"),
        ({"F": T}, {"signals": ["H"]}, "--signal H: no such signal is in both logs; there are F"),
        ({"F": T}, {"given": rules(["FF=1N"])}, "tolerance of FF: no such signal; did you mean 'F'?"),
    ],
)
def test_what_does_not_fit_is_refused(b: dict, others: dict, expected: str):
    with pytest.raises(InputRefused) as refused:
        compare_logs(log_of(T, F=T), log_of(T, b, "b.csv"), **others)
    assert str(refused.value).startswith(expected)


def test_a_short_name_leads_to_the_long_ones():
    with pytest.raises(InputRefused) as refused:
        against(log_of(T, {"controller.F_z": T, "scale.F_z": T}), log_of(T, F_z=T))
    assert str(refused.value) == (
        "b.csv: 'F_z' could be controller.F_z or scale.F_z; choose with --map controller.F_z=COLUMN[UNIT]"
    )


def test_logs_of_different_times_are_refused_with_the_remedy():
    with pytest.raises(InputRefused, match=r"a.csv has 0 .. 9.999 s, b.csv has 50 .. 59.999 s; align them with"):
        against(log_of(T, F=T), log_of(T + 50.0, F=T))
