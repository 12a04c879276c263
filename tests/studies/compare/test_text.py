from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.studies.compare.logs import log_of
from twin.studies.compare.comparison import Comparison, compare_logs
from twin.studies.compare.picture import distinct_signals, draw_comparison
from twin.studies.compare.text import MAX_OUTSIDE_ROWS, comparison_result

T = np.linspace(0.0, 10.0, 1001)


@pytest.fixture
def comparison(tmp_path: Path) -> Comparison:
    """Twelve signals outside and three inside, with a gap in the second log."""
    paths = [tmp_path / f"{'a_rather_long_name_' * 4}{name}.csv" for name in "ab"]
    for path in paths:
        path.write_text(path.name)
    kept = (T < 4.0) | (T > 4.5)
    a = {f"controller.omega_ref[{i}]": np.sin(T) for i in range(15)} | {"plant.z": T}
    b = {name: values[kept] + (0.01 * i if i > 2 else 0.0) for i, (name, values) in enumerate(a.items())}
    del b["plant.z"]
    return compare_logs(log_of(T, a, str(paths[0])), log_of(T[kept], b, str(paths[1])))


def test_the_answer_comes_first_and_everything_fits_80_columns(comparison: Comparison):
    lines = comparison_result(comparison).text.splitlines()
    first = comparison.outside_rows[0]
    answer = f"15 of 16 signals in common: {len(comparison.outside_rows)} of 15 signals leave the tube around A "
    answer += f"(first: {first.signal}, at 0 s), "
    assert " ".join([lines[0], lines[1].strip()]) == f"{answer}compared over 94.8 % of A"
    # names of files are not broken
    assert max(len(line) for line in lines if "rather_long" not in line) <= 80
    assert f"     and {len(comparison.outside_rows) - MAX_OUTSIDE_ROWS} more outside" in lines
    assert "  note     only in A: plant.z" in lines


def test_a_signal_outside_is_told_with_time_value_and_bounds(tmp_path: Path):
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    a, b = log_of(T, F=0.0 * T, path=str(tmp_path / "a")), log_of(T, F=np.where(T < 5.0, 0.0, 1.0))
    text = comparison_result(compare_logs(a, log_of(T, F=b["F"].values, path=str(tmp_path / "b")))).text
    assert "out at 5 s: 1, not in 0 .. 0 N" in text


@pytest.mark.slow
def test_the_picture_is_drawn_and_is_the_same_every_time(comparison: Comparison, tmp_path: Path):
    pictures = [tmp_path / name for name in ("one.png", "two.png")]
    for path in pictures:
        draw_comparison(comparison, path)
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    with Image.open(pictures[0]) as picture:
        assert picture.width >= 1200


def test_what_is_the_same_curve_is_drawn_once_and_named(tmp_path: Path):
    F, other = np.sin(T), np.cos(3.0 * T)
    a = {"plant.F": F, "controller.F": -F + 0.005, "scale.F": np.round(F, 2), "plant.G": other, "plant.H": F}
    # of H only A is the same
    b = {name: values + 0.5 * (T > 5.0) * np.sign(values @ F) for name, values in a.items()} | {"plant.H": F}
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    found = distinct_signals(compare_logs(log_of(T, a, str(tmp_path / "a")), log_of(T, b, str(tmp_path / "b"))))
    together = sorted(sorted([row.signal, *alike]) for row, alike in found)
    assert together == [["controller.F", "plant.F", "scale.F"], ["plant.G"], ["plant.H"]]


def test_the_signal_that_leaves_the_tube_first_is_among_the_rows(tmp_path: Path):
    early = np.where(T > 1.0, 0.06, 0.0)
    a = {f"s.x{i:02}": np.sin(T) for i in range(MAX_OUTSIDE_ROWS + 3)}
    b = {name: values + np.where(T > 5.0, 1.0, 0.0) for name, values in a.items()}
    b["s.x05"] = a["s.x05"] + early
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    lines = comparison_result(
        compare_logs(log_of(T, a, str(tmp_path / "a")), log_of(T, b, str(tmp_path / "b")))
    ).text.splitlines()
    assert "(first: s.x05, at" in lines[0]
    rows = [line.split()[1] for line in lines if line.startswith("OUT")]
    assert len(rows) == MAX_OUTSIDE_ROWS and rows[-1] == "s.x05"
    assert "     and 3 more outside" in lines
