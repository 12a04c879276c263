"""On a head and points made up for the test: the repository holds no digitised curve, and none is invented."""

import datetime
from pathlib import Path

import pytest

from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.studies.paper.digitised.provenance import Provenance, provenance

HEAD = """\
# [figure]
# number = "0"
# panel = "Z"
# curve = "made for a test"
# image = "none"
# [digitised]
# by = "a test"
# on = 2026-01-31
# tool = "none"
# [calibration]
# t_s = [[100, 0.0], [2100, 20.0]]
# controller.F_z_mN = [[900, 0.0], [100, 8000.0]]
# [uncertainty]
# t_s = 0.05
# controller.F_z_mN = 60.0
"""
POINTS = "t_s,controller.F_z_mN\n0,0\n5,100\n6,4900\n"


def made(tmp_path: Path, head: str = HEAD, points: str = POINTS) -> Provenance | None:
    path = tmp_path / "curve.csv"
    path.write_text(head + points)
    return provenance(read_log(path))


def test_the_head_gives_provenance_and_uncertainty_in_si(tmp_path: Path):
    found = made(tmp_path)
    assert found is not None
    assert (found.signal, found.value, found.time) == ("controller.F_z", 0.06, 0.05)
    assert found.head.digitised.on == datetime.date(2026, 1, 31)
    assert found.text == "Fig. 0 Z, made for a test: digitised by a test on 2026-01-31, none"


def test_any_other_csv_file_has_no_provenance(tmp_path: Path):
    assert made(tmp_path, "# measured by hand\n") is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('# curve = "made for a test"\n', "", "[head.figure] missing key 'curve'"),
        ("# by =", "# who =", "[head.digitised] unknown key 'who'"),
        ("# tool =", "# tool ", "its head is not TOML behind #"),
        ("# t_s = [[100, 0.0], [2100, 20.0]]\n", "", "[calibration] t_s is missing; expected two points"),
        ("[[900, 0.0], [100, 8000.0]]", "[[900, 0.0], [900, 8000.0]]", "two points of one pixel or value make no axis"),
        ("controller.F_z_mN = 60.0", "controller.F_z_mN = 4.0", "is less than half a pixel, 5"),
        ("# controller.F_z_mN = 60.0\n", "", "[uncertainty] lacks controller.F_z"),
        ("# t_s = 0.05\n", "", "[uncertainty] lacks the time"),
    ],
)
def test_a_head_that_lacks_something_is_refused(tmp_path: Path, old: str, new: str, expected: str):
    with pytest.raises(LogError) as refused:
        made(tmp_path, HEAD.replace(old, new))
    assert expected in str(refused.value)


def test_a_file_holds_one_curve(tmp_path: Path):
    with pytest.raises(LogError, match="2 curves, expected one"):
        made(tmp_path, HEAD, "t_s,controller.F_z_mN,scale.F_z_N\n0,0,0\n1,1,1\n")


def test_no_curve_is_in_the_repository_without_provenance(root: Path):
    for path in (root / "twin/studies/paper/digitised").glob("*.csv"):
        assert provenance(read_log(path)) is not None
