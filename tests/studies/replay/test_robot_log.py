from pathlib import Path

import pytest

from tests.studies.replay.logs import ANGLES, FIG4, healthy, ran, write_log
from twin.errors import InputRefused
from twin.recording.logs.column_map import column_map
from twin.recording.logs.reader import read_log
from twin.studies.replay.replay import replayed

FORCE = "scale.F_z=scale.F_z"


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A robot's log of counts."""
    return write_log(tmp_path_factory.mktemp("logs") / "log.csv", ran(FIG4)).read_text()


def refused(path: Path, text: str, *maps: str) -> str:
    path.write_text(text)
    with pytest.raises(InputRefused) as problem:
        replayed(read_log(path, column_map(maps)), healthy())
    sentence = str(problem.value)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence
    return sentence


def test_columns_that_are_not_encoders_are_told_with_a_map_to_choose_from(tmp_path: Path, text: str):
    said = refused(tmp_path / "a.csv", text.replace("encoder.count_m", "motor"))
    assert "neither encoder.count_m[0..2] nor estimator.theta_m[0..2] is there; it has motor[0]" in said
    assert "choose with --map 'estimator.theta_m[0]=COLUMN[deg]'" in said


def test_a_missing_joint_is_told(tmp_path: Path, text: str):
    assert "expected 3, one per joint" in refused(tmp_path / "a.csv", text.replace("encoder.count_m[2]", "other"))


def test_a_force_in_another_unit_is_told(tmp_path: Path, text: str):
    said = refused(tmp_path / "a.csv", text.replace("scale.F_z_N", "scale.F_z_mm"))
    assert "scale.F_z is in 'm', expected 'N'; say so with --map" in said
    said = refused(tmp_path / "a.csv", text.replace("scale.F_z_N", "scale.F_z_g"))
    assert "scale.F_z is in 'kg', expected 'N'; grams are a mass: did you mean gf (or kgf)? say so with --map" in said


def test_a_field_that_is_no_number_is_told_with_its_line(tmp_path: Path, text: str):
    lines = text.splitlines()
    lines[10] = lines[10].replace("497", "nan")
    assert " line 11" in refused(tmp_path / "a.csv", "\n".join(lines))


def test_times_that_run_backwards_are_told_with_their_line(tmp_path: Path, text: str):
    lines = text.splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    assert "runs backwards" in refused(tmp_path / "a.csv", "\n".join(lines))


def test_a_log_that_begins_before_zero_is_told(tmp_path: Path, text: str):
    head, first, *rest = text.splitlines()
    said = refused(tmp_path / "a.csv", "\n".join([head, "-1.0" + first[3:], *rest]))
    assert "begins at -1 s, before 0" in said


def test_angles_that_no_pose_fits_are_told_with_what_may_be_wrong(tmp_path: Path):
    path = write_log(tmp_path / "q.csv", ran(FIG4), angles=True)
    head, _, *rest = path.read_text().splitlines()
    said = refused(path, "\n".join([head, "0.0,0,0,0,0,40,170,0", *rest]), *ANGLES, FORCE)
    assert "fit no pose of the robot; are their signs, units and zeros those of the experiment?" in said


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "an empty file"),
        (b"\x89MCAP0\r\n", "damaged"),
        (b"\x00\x01\x02\x03", "not a text file"),
    ],
)
def test_files_that_are_no_logs_are_one_sentence(tmp_path: Path, content: bytes, said: str):
    path = tmp_path / "log.bin"
    path.write_bytes(content)
    with pytest.raises(InputRefused) as problem:
        replayed(read_log(path, {}), healthy())
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)


def test_a_damaged_recording_is_one_sentence(tmp_path: Path):
    content = bytearray(ran(FIG4).path.read_bytes())
    content[len(content) // 2] ^= 1
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(InputRefused, match="damaged at byte"):
        read_log(path, {})


def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes_and_says_so(tmp_path: Path):
    content = ran(FIG4).path.read_bytes()
    path = tmp_path / "run.mcap"
    path.write_bytes(content[: len(content) // 2])
    replay = replayed(read_log(path, {}), healthy())
    assert "unfinished recording" in replay.log.notes[0]
    assert 5.0 < replay.log.t[-1] < 15.0
