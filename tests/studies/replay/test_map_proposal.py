"""The map that is proposed for a robot's CSV file, read back as a log of it."""

from pathlib import Path

import pytest

from tests.studies.replay.logs import FIG4, ran, write_log
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.studies.replay.map_proposal import propose

ROWS = "0,10,11,12,20,21,22,-5\n2,11,12,13,21,22,23,-5.1\n4,12,13,14,22,23,24,-4.9\n"


def proposed(folder: Path, text: str) -> tuple[str, bool]:
    file = folder / "robot.csv"
    file.write_text(text)
    path, complete = propose(file)
    assert path == folder / "robot.map.toml"
    return path.read_text(), complete


def test_names_and_units_that_leave_no_doubt_make_a_map_that_reads_the_file(tmp_path: Path):
    head = "stamp_ms,qMotor1_deg,qMotor2_deg,qMotor3_deg,q_link_1_deg,q_link_2_deg,q_link_3_deg,Fz (N)\n"
    _, complete = proposed(tmp_path, head + ROWS)
    assert complete
    log = read_log(tmp_path / "robot.csv", column_map([tmp_path / "robot.map.toml"]))
    assert log["scale.F_z"].t.tolist() == [0.0, 0.002, 0.004]
    # pressing is positive: this sensor counts the other way
    assert log["scale.F_z"].values.tolist() == [5.0, 5.1, 4.9]
    assert log["estimator.theta_m[2]"].values[0] == pytest.approx(0.20944, rel=1e-4)
    assert log["estimator.theta_l[0]"].values[0] == pytest.approx(0.34907, rel=1e-4)


@pytest.mark.parametrize("angles", [True, False])
def test_the_log_of_a_run_is_read_as_it_is(tmp_path: Path, angles: bool):
    log = write_log(tmp_path / "monday.csv", ran(FIG4), angles=angles)
    path, complete = propose(log)
    found = read_log(log, column_map([path]))
    kind = "estimator.theta" if angles else "encoder.count"
    assert complete
    assert sorted(found.series) == sorted([*(f"{kind}_{s}[{i}]" for s in "ml" for i in range(3)), "scale.F_z"])
    assert found["scale.F_z"].values.max() == pytest.approx(read_log(ran(FIG4).path)["scale.F_z"].values.max())


def test_what_is_in_doubt_stands_in_it_as_comments(tmp_path: Path):
    head = "time,a1_deg,a2_deg,a3_deg,b1_deg,b2_deg,b3_deg,cell\n"
    text, complete = proposed(tmp_path, head + ROWS)
    assert not complete
    assert '# time = { column = "time", unit = "s" }   # in which unit?' in text
    # either triple may be of either side
    assert text.count('# "estimator.theta_m[0]"') == text.count('# "estimator.theta_l[0]"') == 2
    assert "# not used: cell" in text


def test_one_side_that_is_named_tells_the_other_and_grams_become_gf(tmp_path: Path):
    head = "t_s,enc1,enc2,enc3,motor1,motor2,motor3,weight_g\n"
    text, complete = proposed(tmp_path, head + ROWS)
    assert complete
    assert '"encoder.count_m[0]" = { column = "motor1" }' in text
    assert '"encoder.count_l[2]" = { column = "enc3" }' in text
    assert '"scale.F_z" = { column = "weight_g", unit = "gf", sign = -1 }' in text


def test_without_angles_and_force_it_says_what_is_missing(tmp_path: Path):
    text, complete = proposed(tmp_path, "t_s,x\n0,1\n1,2\n")
    assert not complete and "no three columns are angles or counts" in text and "No column is a force" in text


def test_a_map_that_is_there_is_not_touched(tmp_path: Path):
    (tmp_path / "robot.map.toml").write_text("mine")
    with pytest.raises(LogError, match="is there already and is not touched"):
        proposed(tmp_path, "t_s,x\n0,1\n1,2\n")
    assert (tmp_path / "robot.map.toml").read_text() == "mine"
