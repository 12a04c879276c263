"""`twin shadow` beside logs: what it says, and what other commands make of its recording."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.kernel.recording.logs.bags import NS
from tests.studies.replay.logs import ANGLES, EXPERIMENTS, FIG4, ran, write_log
from tests.studies.replay.test_plausible import changed
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.reader import Recording, read
from twin.report.page.page import write_report
from twin.studies.command import ignore_progress
from twin.studies.compare.study import compare
from twin.studies.replay.study import replay
from twin.studies.shadow.study import shadow

ROBOT = EXPERIMENTS / f"{FIG4}.toml"
DEAD = "fault=[{kind='drive_dead', target='drive_2', onset_s=8.0}]"
MAP = [
    f"estimator.theta_{side}[{i}]=/joint_states.position.{side}{i + 1}" for side in "ml" for i in range(3)
]  # fmt: skip


def angles_of(run: Recording) -> NDArray[np.float64]:
    """Of joints and motors (n, 6), rad."""
    return np.hstack([run["estimator.theta_l"], run["estimator.theta_m"]])


def bag(
    path: Path,
    run: Recording,
    keep: slice = slice(None),
    angles: NDArray[np.float64] | None = None,
    lag: float = 0.0,
    plugin: str = "SQLITE3",
) -> Path:
    """A bag of the robot of `run`, with stamps of its own clock, in which joints come in another order.

    Args:
        path: folder of the bag.
        run: of the robot.
        keep: rows.
        angles: of joints and motors (n, 6), rad, in place of those of `run`.
        lag: by which the recorder falls behind more and more (s/s).
        plugin: storage of the bag.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    from tests.kernel.recording.logs.bags import STORE, joints

    kind = "sensor_msgs/msg/JointState"
    angles = angles_of(run)[keep] if angles is None else angles
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        topic = writer.add_connection("/joint_states", kind, typestore=STORE)
        for t, row in zip(run.time("estimator")[keep].tolist(), angles.tolist(), strict=True):
            names = ["l1", "l2", "l3", "m1", "m2", "m3"]
            message = joints(1000.0 + t, **dict(zip(names, row, strict=True)))
            # a recorder that is 3 ms behind
            writer.write(topic, round((1_700_000_000.003 + (1.0 + lag) * t) * NS), STORE.serialize_cdr(message, kind))
    return path


def test_beside_the_log_of_a_healthy_robot_the_two_do_not_part(tmp_path: Path):
    log = write_log(tmp_path / "monday.csv", ran(FIG4), angles=True)
    report = shadow(ROBOT, str(log), [*ANGLES, "scale.F_z=scale.F_z"], speed=0.0, out=tmp_path / "out")
    assert report.exit_code == 0
    assert report.text.splitlines()[0] == f"{FIG4}: followed {log} for 20.00 s"
    assert all(len(line) <= 80 for line in report.text.splitlines() if "/" not in line)
    facts = json.loads((tmp_path / "out" / "shadow.json").read_text())
    assert facts["counts"] == dict.fromkeys(facts["counts"], 0) | {"samples": 10001}
    assert facts["residuals"]["force"]["rms"] < 0.05
    # deg; what rounding can do is 0.04
    assert np.degrees(facts["residuals"]["plant joint 1"]["rms"]) < 0.04
    # its commands are not known: the twin's own lead the predictions
    assert facts["ahead"]["predictions"] == 39 and facts["ahead"]["in_band"] > 0.95
    assert facts["ahead"]["error_rms_N"] < 0.1 * facts["ahead"]["last_value_rms_N"]
    assert "ahead      39 predictions of 1 s; " in report.text


def test_what_would_be_is_recorded_beside_what_is_predicted_with_the_same_bytes_twice(tmp_path: Path):
    asked = "controller.position.kp_per_s=3"
    for name in ("once", "twice"):
        report = shadow(
            ROBOT,
            str(ran(FIG4).path),
            speed=0.0,
            duration_s=2.0,
            what_if=[asked],
            force_limit_N=4.0,
            out=tmp_path / name,
        )
    assert f"what if {asked}: " in report.text
    recording = read(tmp_path / "once")
    made, later = recording["ahead.made"], recording["what_if/1.p_z"]
    np.testing.assert_allclose(made[:3], [0.5, 1.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(recording.time("ahead"), made + 0.1, atol=1e-9)
    assert recording.fields()["what_if/1.p_z"].meaning.endswith(asked)
    # on its way down it follows more closely
    assert np.all(later[1:3, -1] < recording["ahead.p_z"][1:3, -1] - 1e-4)
    assert (tmp_path / "once" / "run.mcap").read_bytes() == (tmp_path / "twice" / "run.mcap").read_bytes()


@pytest.mark.slow
def test_every_reading_command_reads_both_sides_of_the_recording(tmp_path: Path):
    run = ran(FIG4)
    shadow(ROBOT, str(bag(tmp_path / "bag", run)), MAP, speed=0.0, out=tmp_path / "out")
    recording = read(tmp_path / "out")
    assert recording.complete
    # by stamps
    np.testing.assert_allclose(recording.time("estimator"), run.time("estimator"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording["estimator.p_B"], run["estimator.p_B"], rtol=0, atol=1e-12)
    again = replay(tmp_path / "out", plant=True, out=tmp_path / "again")
    assert again.exit_code == 0 and again.text.splitlines()[0].startswith(f"{FIG4}: robot and twin match")
    logs = [run.path, tmp_path / "out"]
    same = compare(ignore_progress, logs, signals=["estimator.p_B"], tolerances=["0.001mm"], out=tmp_path / "c")
    assert same.exit_code == 0
    write_report([tmp_path / "out"], tmp_path / "page.html")
    assert (tmp_path / "page.html").is_file()
    # and beside it once more
    shadow(ROBOT, str(tmp_path / "out"), speed=0.0, out=tmp_path / "twice")
    assert read(tmp_path / "twice")["estimator.p_B"].tobytes() == recording["estimator.p_B"].tobytes()


def test_the_pace_of_a_log_changes_nothing_of_what_is_recorded(tmp_path: Path):
    run = ran(FIG4)
    log = str(bag(tmp_path / "bag", run, slice(1000)))
    for name, speed in (("fast", 0.0), ("paced", 8.0)):
        shadow(ROBOT, log, MAP, speed=speed, out=tmp_path / name)
    fast, paced = read(tmp_path / "fast"), read(tmp_path / "paced")
    for key in fast.fields():
        if not key.startswith(("plant.", "residual")):
            assert fast[key].tobytes() == paced[key].tobytes(), key
        # the plant model's inputs are interpolated in slices
        np.testing.assert_allclose(fast[key], paced[key], rtol=0, atol=1e-8, err_msg=key)


def test_twins_rows_are_recorded_once_per_call_of_its_controller_if_the_experiment_says_so(tmp_path: Path):
    log, slow, kept = str(ran(FIG4).path), "controller.period_ms=4", {}
    for rate in ("tick", "controller"):
        settings = [slow, f"recording.rate={rate}"]
        shadow(ROBOT, log, settings=settings, speed=0.0, duration_s=2.0, no_alarm=True, out=tmp_path / rate)
        kept[rate] = read(tmp_path / rate)
    every, calls = kept["tick"], kept["controller"]
    assert len(calls["encoder.count_m"]) == len(calls["controller.omega_ref"]) == len(every["controller.omega_ref"])
    called = np.isin(every.time("shadow"), every.time("controller"))
    assert 0.4 < np.mean(called) < 0.6
    np.testing.assert_array_equal(calls["shadow.p_B"], every["shadow.p_B"][called])
    for rare in ("ahead.made", "scale.F_z"):
        np.testing.assert_array_equal(calls[rare], every[rare])


def test_a_session_ends_after_the_time_that_was_asked_for(tmp_path: Path):
    shadow(ROBOT, str(ran(FIG4).path), speed=0.0, duration_s=2.0, out=tmp_path / "out")
    assert 2.0 <= read(tmp_path / "out").time("encoder")[-1] < 3.5


def test_without_an_alarm_there_is_nothing_to_accept(tmp_path: Path):
    with pytest.raises(InputRefused, match="--adapt: needs the alarm; leave out --no-alarm"):
        shadow(ROBOT, str(ran(FIG4).path), speed=0.0, adapt=True, no_alarm=True, out=tmp_path / "out")


def test_a_session_ends_with_its_verdict_and_exit_code(tmp_path: Path):
    healthy, dead = (ran(FIG4, *settings).path for settings in ((), (DEAD,)))
    for log, options, kind, code in (
        (healthy, {}, "match", 0), (dead, {}, "diverge", 1), (healthy, {"duration_s": 1.2}, "not watched", 0),
        (healthy, {"no_alarm": True}, "not watched", 0),
    ):  # fmt: skip
        report = shadow(ROBOT, str(log), speed=0.0, out=tmp_path / f"{kind}{len(options)}{code}{len(str(options))}",
                        **options)  # fmt: skip
        assert (report.facts["verdict"], report.exit_code) == (kind, code), report.text
        assert "  verdict    " in report.text
        assert ("fewer than 3.5 s of samples" in report.text) == ("duration_s" in options)


@pytest.mark.parametrize(("duration", "kind"), [(3.4, "not watched"), (3.6, "match")])
def test_the_shortest_log_that_is_watched_is_as_long_as_the_refusal_says(tmp_path: Path, duration: float, kind: str):
    log = write_log(tmp_path / "log.csv", ran(FIG4), keep=ran(FIG4).time("encoder") < duration, angles=True)
    report = shadow(ROBOT, str(log), ANGLES, speed=0.0, out=tmp_path / "out")
    assert report.facts["verdict"] == kind, report.text


def test_the_caution_of_a_robot_that_was_not_identified_names_the_keys_that_are_missing(tmp_path: Path):
    log = write_log(tmp_path / "log.csv", ran(FIG4), keep=np.arange(10001) < 500, angles=True)
    known = {"k_s_Nm_per_rad": 1.0, "backlash_deg": 0.1}
    for number in (1, 2):
        robot = tmp_path / f"identified{number}.toml"
        lines = [f'{key} = {{ value = {value}, source = "identified from a.csv" }}' for key, value in known.items()]
        robot.write_text("\n".join([f'extends = "{ROBOT}"', "[plant]", *lines[:number]]))
        report = shadow(robot, str(log), ANGLES, speed=0.0, no_alarm=True, out=tmp_path / f"out{number}")
        text = " ".join(report.text.split())
        assert ("until [plant] has an identified k_s_Nm_per_rad and backlash_deg" in text) == (number == 1)


def test_a_rate_without_tolerances_is_not_watched_and_says_why(tmp_path: Path):
    log = write_log(tmp_path / "odd.csv", ran(FIG4), keep=np.arange(10001) % 3 == 0, angles=True)
    report = shadow(ROBOT, str(log), ANGLES, speed=0.0, out=tmp_path / "out")
    assert "not watched: the robot is sampled at 166.7 Hz; there are tolerances for" in " ".join(report.text.split())
    assert report.exit_code == 0


@pytest.mark.parametrize("step", [1e5, 9e7, 1.7e9])
def test_a_clock_that_steps_far_in_a_log_begins_anew_and_costs_no_memory(tmp_path: Path, step: float):
    log = write_log(tmp_path / "log.csv", ran(FIG4), angles=True)
    head, *lines = log.read_text().splitlines()
    later = [f"{float(line.partition(',')[0]) + step!r},{line.partition(',')[2]}" for line in lines[5000:]]
    log.write_text("\n".join([head, *lines[:5000], *later]) + "\n")
    report = shadow(ROBOT, str(log), ANGLES, speed=0.0, no_alarm=True, out=tmp_path / "out")
    assert report.facts["counts"]["samples"] == 10001 and report.facts["counts"]["gaps"] == 1
    # predictions go on behind it
    assert read(tmp_path / "out")["ahead.made"][-1] > step
    assert any(event.text.startswith("no samples for ") for event in read(tmp_path / "out").events)


@pytest.mark.parametrize(
    ("source", "maps", "expected"),
    [
        ("ros1:/joint_states", MAP, "'ros1:' is not a transport; transports are ros2: and zenoh:"),
        ("ros2:joint_states", MAP, "expected a topic that begins with /, such as ros2:/joint_states"),
        ("nothing.csv", MAP, "no such file or folder"),
        ("ros2:/joint_states", [], '"estimator.theta_m[0]" = "/joint_states.position.m1"'),
        ("ros2:/joint_state", MAP, "no column of the map is of /joint_state; they are of /joint_states"),
        ("ros2:/joint_states", MAP[1:], "the map lacks estimator.theta_m[0]; write"),
        ("ros2:/joint_states", [*MAP[1:], "estimator.thetam[0]=/j.p"], "lacks estimator.theta_m[0]; did you mean"),
        ("ros2:/joint_states", [*MAP[1:], "estimator.theta_m[0]=m1"], "names no topic; write /TOPIC.FIELD"),
    ],
)
def test_a_source_or_map_that_cannot_be_is_refused_with_what_to_write(source: str, maps: list[str], expected: str):
    from twin.studies.shadow.sources import refuse_source

    with pytest.raises(InputRefused) as refused:
        refuse_source(source)
        shadow(ROBOT, source, maps)
    assert expected in str(refused.value)


def test_a_bag_without_a_map_is_refused_with_one_to_begin_with(tmp_path: Path):
    with pytest.raises(InputRefused, match=r'"estimator.theta_l\[2\]" = "/joint_states.position.l3"'):
        shadow(ROBOT, str(bag(tmp_path / "bag", ran(FIG4), slice(100))))


def test_a_joint_that_the_bag_has_not_is_named(tmp_path: Path):
    maps = [*MAP[:5], "estimator.theta_l[2]=/joint_states.position.l4"]
    with pytest.raises(InputRefused, match=r"has no 'position.l4' for estimator.theta_l\[2\]; did you mean 'l3'"):
        shadow(ROBOT, str(bag(tmp_path / "bag", ran(FIG4), slice(1000))), maps, speed=0.0, out=tmp_path / "out")


@pytest.mark.parametrize(("kind", "start"), [("csv", 5.0), ("log times", 5.0), ("stamps", 1005.0)])
def test_a_part_of_a_log_is_the_one_that_replay_takes(tmp_path: Path, kind: str, start: float):
    if kind == "csv":
        log, maps = write_log(tmp_path / "log.csv", ran(FIG4), angles=True), ANGLES
    else:
        log = bag(tmp_path / "bag", ran(FIG4), lag=0.01)
        maps = MAP if kind == "log times" else [*MAP, "time=header.stamp"]
    report = shadow(
        ROBOT, str(log), maps, speed=0.0, from_s=start, to_s=start + 1.5, no_alarm=True, out=tmp_path / "out"
    )
    expected = read_log(log, column_map(maps), (start, start + 1.5)).vector("estimator.theta_m").values
    # a recorder that falls behind writes fewer samples in the same time
    assert len(expected) == (742 if kind == "log times" else 751)
    assert report.facts["counts"]["samples"] == len(expected)
    found = read(tmp_path / "out")["estimator.theta_m"]
    np.testing.assert_allclose(found[[0, -1]], expected[[0, -1]], rtol=0, atol=1e-9)


def test_a_part_without_samples_is_refused_with_the_times_that_there_are(tmp_path: Path):
    log = bag(tmp_path / "bag", ran(FIG4), slice(1001))
    with pytest.raises(LogError, match="no samples from 5 to 6 s; it has 1000 to 1002 s"):
        shadow(ROBOT, str(log), [*MAP, "time=header.stamp"], from_s=5.0, to_s=6.0, speed=0.0, out=tmp_path / "out")


@pytest.mark.parametrize(("each", "is_refused"), [(16, False), (17, True)])
def test_samples_of_a_bag_that_lack_one_of_six_angles_may_be_5_percent_together(
    tmp_path: Path, each: int, is_refused: bool
):
    angles = angles_of(ran(FIG4))[:2000]
    for column in range(6):
        # other samples for each of the six
        angles[100 + 6 * np.arange(each) + column, column] = np.nan
    log = str(bag(tmp_path / "bag", ran(FIG4), slice(2000), angles))

    def follow() -> int:
        report = shadow(ROBOT, log, MAP, speed=0.0, no_alarm=True, out=tmp_path / "out")
        return report.facts["counts"]["invalid"]

    if is_refused:
        with pytest.raises(LogError, match="102 of 2000 samples of an encoder are NaN, null or infinite"):
            follow()
    else:
        assert follow() == 96


@pytest.mark.parametrize("what", ["force", "legs", "sides", "degrees", "opposite"])
def test_a_wrong_map_ends_with_the_one_to_write(tmp_path: Path, what: str):
    log = str(write_log(tmp_path / "a.csv", ran(FIG4), angles=True))
    maps = changed(what)
    # of angles in degrees the joints are found first
    for mistake in range(1 + (what == "degrees")):
        text = map_to_write(log, maps, tmp_path / f"out{mistake}")
        assert ("motor and joint 2 turn in opposite senses" in text) == (what == "opposite")
        (tmp_path / "map.toml").write_text(text.split("write in the map:\n")[1])
        maps = [str(tmp_path / "map.toml")]
    again = shadow(ROBOT, log, maps, speed=0.0, no_alarm=True, out=tmp_path / "again")
    assert again.facts["verdict"] == "not watched"


def map_to_write(log: str, maps: list[str], out: Path) -> str:
    """What a session says of a wrong map: it is refused, or ends with the verdict that the two part."""
    try:
        report = shadow(ROBOT, log, maps, speed=0.0, no_alarm=True, out=out)
    except InputRefused as refused:
        return str(refused)
    assert (report.facts["verdict"], report.exit_code) == ("diverge", 1)
    return str(report.facts["verdict_text"])
