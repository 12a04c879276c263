"""A session whose topics begin and end apart, lose a joint, contradict each other; what it says, and its verdict."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.recording.logs.bags import NS, STORE, wrench
from tests.kernel.recording.logs.bags import joints as joint_message
from tests.studies.replay.logs import FIG4, ran
from tests.studies.shadow.test_following import EXPERIMENT, MODEL, N, said
from tests.studies.shadow.test_study import MAP, ROBOT, bag
from twin.kernel.errors import ComponentFailed, RecordingWriteError, TwinError
from twin.kernel.process.process import environment
from twin.kernel.recording import writer
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import recording_log
from twin.kernel.recording.reader import read
from twin.kernel.recording.sources.arrival import Arrival
from twin.kernel.recording.sources.signals import Reading
from twin.studies.replay.samples import robot_samples
from twin.studies.shadow import session as session_module
from twin.studies.shadow.alarm import CHANNELS, Tolerances, WatchState
from twin.studies.shadow.following import AlarmWatch, OwnController, twin_of
from twin.studies.shadow.mapping import wanted_signals
from twin.studies.shadow.recording import ShadowRecording
from twin.studies.shadow.session import Session
from twin.studies.shadow.study import shadow
from twin.studies.shadow.text import shadow_result
from twin.studies.shadow.verdict import SessionSummary, verdict_of

START = 10**18
JOINTS, COMMANDS = tuple(range(6)), (6, 7, 8)
COMMANDED = [f"controller.omega_ref[{i}]=/commands.velocity.m{i + 1}" for i in range(3)]


class Topics:
    """A log with /joint_states and /commands, each arrival at its time.

    Args:
        arrivals: of both.
    """

    name, drop_count, at_end, has_messages = "robot", 0, False, False

    def __init__(self, arrivals: list[Arrival]):
        self.arrivals = sorted(arrivals, key=lambda one: one.arrived)
        self.at = self.next = 0

    def topic_types(self) -> dict[str, str]:
        return {"/joint_states": "sensor_msgs/msg/JointState", "/commands": "sensor_msgs/msg/JointState"}

    def subscribe(self, topic: str) -> None:
        """Readings."""

    def publisher_count(self, topic: str) -> int:
        return 1

    def receive(self, wait: float) -> list[Arrival]:
        taken = self.arrivals[self.next : self.next + 50]
        self.next, self.at_end = self.next + 50, not taken
        self.at = taken[-1].arrived if taken else self.at
        return taken

    def now_ns(self) -> int:
        return self.at

    def close(self) -> None:
        """Nothing to leave."""


def joints(begin: int = 0, end: int = N, lacking: int | None = None, after: int = N) -> list[Arrival]:
    """Messages of the robot of Fig. 4; joint `lacking` is not in those from `after` on."""
    robot, found = said(ran(FIG4)), []
    for k, row in enumerate(robot.u[:, :6].tolist()):
        columns = tuple(c for c in JOINTS if k < after or c != lacking)
        reading = Reading(START + 2_000_000 * k, columns, tuple(row[c] for c in columns))
        found.append(Arrival("/joint_states", reading.stamp, reading))
    return found[begin:end]


def commands(end: int = N + 900) -> list[Arrival]:
    """Those of its controller, over and over."""
    speeds = np.nan_to_num(said(ran(FIG4)).only("omega_ref")).tolist()
    readings = [Reading(START + 2_000_000 * k, COMMANDS, tuple(speeds[k % N])) for k in range(end)]
    return [Arrival("/commands", one.stamp, one) for one in readings]


def followed(arrivals: list[Arrival], folder: Path, watched: AlarmWatch | None = None) -> SessionSummary:
    """A session beside them."""
    twin = twin_of(EXPERIMENT, MODEL, "robot", watched)
    columns, wanted = column_map([*MAP, *COMMANDED]), wanted_signals(MODEL.belief)
    session = Session(Topics(arrivals), columns, wanted, twin, MODEL, 0.03, np.inf, False, lambda text: None)
    session.wait_for_topics()
    return session.follow(lambda: folder / "run.mcap")


def whole_run(*settings: str, period: float = 2e-3, after: int = 10**6) -> list[Arrival]:
    """Messages of Fig. 4 in all its 20 s, with commands; from sample `after` on one is sent every `period` (s)."""
    log = recording_log(ran(FIG4, *settings))
    rows = np.hstack([robot_samples(log, MODEL.belief).counts, log.vector("controller.omega_ref").values])
    t, found = 0.0, list[Arrival]()
    while round(t / 2e-3) < len(rows):
        stamp = START + round(t * NS)
        reading = Reading(stamp, JOINTS + COMMANDS, tuple(rows[round(t / 2e-3)].tolist()))
        found.append(Arrival("/joint_states", stamp, reading))
        t += 2e-3 if len(found) < after else period
    return found


def events(folder: Path) -> list[str]:
    return [event.text for event in read(folder / "run.mcap").events]


JUMP = "fault=[{kind='encoder_bias', target='joint_encoder_1', onset_s=3.0, magnitude_deg=0.3}]"
NARROW = {500.0: Tolerances(dict.fromkeys(CHANNELS, 1e9) | {"spread": 0.3}, dict.fromkeys(CHANNELS, 0.01))}
WIDE = {500.0: Tolerances(dict.fromkeys(CHANNELS, 1e9), dict.fromkeys(CHANNELS, 1.0))}


def test_commands_that_go_on_without_joints_are_a_silence_and_no_error(tmp_path: Path):
    watched = AlarmWatch(WIDE, 1.0)
    told = followed([*joints(end=1800), *commands()], tmp_path, watched)
    assert told.counts.samples == 1800
    assert "no sample for 2 s: nothing comes of /joint_states" in events(tmp_path)
    assert watched.changes[-1].state is WatchState.NOT_WATCHED
    assert verdict_of(told).text.startswith("robot and twin match until 3.6 s, then not watched: nothing comes of")


def test_commands_that_begin_before_the_joints_or_end_before_them_are_no_error(tmp_path: Path):
    told = followed([*joints(begin=1200), *commands(end=2200)], tmp_path)
    assert told.counts.samples == N - 1200 and not told.silent


def test_a_joint_that_messages_name_no_longer_is_named_and_nothing_is_watched_from_then_on(tmp_path: Path):
    watched = AlarmWatch(WIDE, 1.0)
    told = followed([*joints(lacking=1, after=1800), *commands()], tmp_path, watched)
    assert "no sample for 2 s: no message has /joint_states.position.m2" in events(tmp_path)
    assert watched.changes[-1].state is WatchState.NOT_WATCHED
    text = shadow_result(told, FIG4, {}).text
    assert "then not watched: no" in text and shadow_result(told, FIG4, {}).exit_code == 0


def test_after_a_silence_the_watch_goes_on(tmp_path: Path):
    watched = AlarmWatch(WIDE, 1.0)
    late = [Arrival(one.topic, one.arrived, one.data) for one in joints(begin=2250)]
    told = followed([*joints(end=1000), *late, *commands(N)], tmp_path, watched)
    assert not told.silent
    assert [one.state for one in watched.changes][:1] == [WatchState.NOT_WATCHED]


@pytest.mark.parametrize(("settings", "code"), [((JUMP,), 1), ((), 0)])
def test_a_rate_without_tolerances_neither_takes_an_alarm_back_nor_the_time_that_was_watched(
    tmp_path: Path, settings: tuple[str, ...], code: int
):
    watched = AlarmWatch(NARROW, 1.0)
    told = followed(whole_run(*settings, period=6e-3, after=4000), tmp_path, watched)
    assert any(text.startswith("no alarm: the robot is sampled at 166.7 Hz") for text in events(tmp_path))
    result = shadow_result(told, FIG4, {})
    assert result.exit_code == code and bool(result.facts["alarms"]) == bool(code)
    expected = (
        r"diverge since \d" if code else r"match until \d.* s, then not watched: the robot is sampled at 166.7 Hz"
    )
    assert re.match(f"robot and twin {expected}", verdict_of(told).text)
    # no level is shown of what is not watched
    assert 8.0 < read(tmp_path / "run.mcap").time("alarm")[-1] < 10.0


def test_a_silence_in_the_middle_is_in_the_verdict(tmp_path: Path):
    run = whole_run()
    # others come on
    beside = [
        Arrival("/commands", one.arrived, one.data._replace(columns=(6,), values=(0.0,))) for one in run[3000:5000]
    ]
    watched = AlarmWatch(WIDE, 1.0)
    told = followed([*run[:3000], *beside, *run[5000:]], tmp_path, watched)
    assert verdict_of(told).text == "robot and twin match (not watched for up to 5 s)"
    assert [one.t for one in watched.changes] == pytest.approx([6.0, 10.5], abs=0.01)


def test_the_line_shows_a_silence_and_what_is_missing(tmp_path: Path):
    arrivals, lines = [*joints(lacking=1, after=1800), *commands()], []

    class Followed(Session):
        def _note_silence(self, sampled: bool) -> None:
            super()._note_silence(sampled)
            lines.append(self.line())

    twin, columns = twin_of(EXPERIMENT, MODEL, "robot"), column_map([*MAP, *COMMANDED])
    wanted = wanted_signals(MODEL.belief)
    session = Followed(Topics(arrivals), columns, wanted, twin, MODEL, 0.03, np.inf, False, lambda text: None)
    session.wait_for_topics()
    session.follow(lambda: tmp_path / "run.mcap")
    assert lines[-1] == "3.6 s  no sample for 3 s: no message has /joint_states.position.m2"
    assert "500 Hz" in lines[10] and "no sample" not in lines[10]


def test_the_summary_says_what_was_watched_and_what_was_not(tmp_path: Path):
    told = followed(joints(), tmp_path)
    assert told.measured_signals == ["motor angles", "joint angles"]
    text = " ".join(shadow_result(told, FIG4, {}).text.split())
    assert "watched motor angles, joint angles; no force, no commands, no torques" in text
    assert "verdict not watched: " in text


@pytest.mark.parametrize("what", ["motors exchanged", "publishers"])
def test_gross_disagreement_parts_robot_and_twin_without_tolerances(tmp_path: Path, what: str):
    arrivals = joints()
    if what == "motors exchanged":
        order = (1, 2, 0, 3, 4, 5)
        arrivals = [
            one._replace(data=one.data._replace(values=tuple(one.data.values[k] for k in order))) for one in arrivals
        ]
    else:
        # another robot stands where this one was at first
        other = arrivals[0].data.values
        arrivals += [Arrival("/joint_states", one.arrived + 10**6, Reading(one.arrived + 10**6, JOINTS, other))
                     for one in arrivals]  # fmt: skip
    told = followed(arrivals, tmp_path)
    verdict = verdict_of(told)
    assert verdict.kind == "diverge" and any(text.startswith("robot and twin diverge: ") for text in events(tmp_path))
    assert shadow_result(told, FIG4, {}).exit_code == 1


def test_a_healthy_robot_is_in_no_gross_disagreement(tmp_path: Path):
    told = followed([*joints(), *commands(N)], tmp_path)
    assert verdict_of(told).kind == "not watched" and shadow_result(told, FIG4, {}).exit_code == 0


def test_a_clock_that_is_set_and_a_rate_that_changes_are_events(tmp_path: Path):
    set_ahead = [
        one._replace(data=one.data._replace(stamp=one.data.stamp + NS)) if k >= 1000 else one
        for k, one in enumerate(joints())
    ]
    told = followed(set_ahead, tmp_path)
    assert "the robot's clock was set by +1.000 s; time continues by arrivals" in events(tmp_path)
    assert told.counts.missing == 0
    slower = [one for k, one in enumerate(joints()) if k < 1000 or k % 2]
    followed(slower, tmp_path)
    assert "the rate has changed from 500 to 250 Hz" in events(tmp_path)


@pytest.mark.parametrize(("period", "is_event"), [(2.25e-3, True), (2.15e-3, False)])
def test_a_rate_that_changes_by_a_tenth_is_an_event(tmp_path: Path, period: float, is_event: bool):
    followed(whole_run(period=period, after=2000), tmp_path)
    changed = [text for text in events(tmp_path) if text.startswith("the rate has changed")]
    assert changed == (["the rate has changed from 500 to 444.4 Hz"] if is_event else [])


def test_a_truncated_bag_is_reported(tmp_path: Path):
    path = bag(tmp_path / "bag", ran(FIG4), slice(1000))
    (path / "metadata.yaml").unlink()
    report = shadow(ROBOT, str(path), MAP, speed=0.0, out=tmp_path / "out")
    assert "no metadata.yaml: the recorder was stopped before it wrote one" in " ".join(report.text.split())


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_a_bag_whose_data_file_is_cut_off_is_refused_or_reported(tmp_path: Path, plugin: str):
    path = bag(tmp_path / "bag", ran(FIG4), plugin=plugin)
    (file,) = (one for one in path.iterdir() if one.name != "metadata.yaml")
    # in the middle of a page, and of a chunk
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10 // 4096 * 4096 + 100])
    if plugin == "SQLITE3":
        with pytest.raises(LogError, match="damaged, it is cut off; recover what is readable first"):
            shadow(ROBOT, str(path), MAP, speed=0.0, out=tmp_path / "out")
        return
    report = shadow(ROBOT, str(path), MAP, speed=0.0, out=tmp_path / "out")
    assert 1000 < report.facts["counts"]["samples"] < 10000
    assert ".mcap: the file ends early: read " in " ".join(report.text.split())


@pytest.mark.parametrize("problem", [ComponentFailed("it failed"), RecordingWriteError("the disk is full")])
def test_a_session_whose_component_or_recording_fails_ends_with_3_and_keeps_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: TwinError
):
    def fail(*arguments: object) -> None:
        raise problem

    target = OwnController if isinstance(problem, ComponentFailed) else ShadowRecording
    monkeypatch.setattr(target, "feed" if target is OwnController else "flush", fail)
    monkeypatch.setattr(session_module, "FLUSH_PERIOD", 0.0)
    with pytest.raises(type(problem)) as failed:
        shadow(ROBOT, str(ran(FIG4).path), speed=0.0, no_alarm=True, out=tmp_path / "out")
    assert failed.value.exit_code == 3


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="a signal of POSIX")
@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM"])
def test_a_session_that_a_signal_ends_has_its_summary_and_exit_code(tmp_path: Path, name: str):
    out = tmp_path / "out"
    words = [sys.executable, "-m", "twin", "shadow", FIG4, "--source", str(ran(FIG4).path), "--speed", "0.1"]
    process = subprocess.Popen(
        [*words, "--no-alarm", "--out", str(out)], env=environment(), text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )  # fmt: skip
    try:
        # the log lasts 200 s
        while not (out / "run.mcap.partial").is_file():
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        process.send_signal(getattr(signal, name))
        text, errors = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert "ended by hand" in text and "  verdict    not watched" in text
    assert read(out).complete


def test_ctrl_c_in_the_middle_of_a_write_loses_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    log, written = str(ran(FIG4).path), []

    def write_chunk(*arguments: Any) -> Any:
        written.append(arguments)
        if len(written) == 3:
            signal.raise_signal(signal.SIGINT)
        return make_chunk(*arguments)

    make_chunk = writer.make_chunk
    monkeypatch.setattr(writer, "make_chunk", write_chunk)
    report = shadow(ROBOT, log, speed=0.0, no_alarm=True, out=tmp_path / "out")
    assert "ended by hand" in report.text
    recording = read(tmp_path / "out")
    assert recording.complete
    assert 1.0 < recording.time("estimator")[-1] < 15.0


class Clock:
    """`time` of a session, whose sleeps take no time."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_after_ten_seconds_without_a_topic_domain_interfaces_and_causes_are_printed_once(
    monkeypatch: pytest.MonkeyPatch,
):
    clock, printed = Clock(), list[tuple[float, str]]()

    class Late(Topics):
        def topic_types(self) -> dict[str, str]:
            return super().topic_types() if clock.now > 140.0 else {}

    monkeypatch.setattr(session_module, "time", clock)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    columns, wanted = column_map([*MAP, *COMMANDED]), wanted_signals(MODEL.belief)
    session = Session(
        Late([]), columns, wanted, twin_of(EXPERIMENT, MODEL, "robot"), MODEL, 0.03, np.inf, True, lambda text: None,
        announce=lambda text: printed.append((clock.now, text)),
    )  # fmt: skip
    session.wait_for_topics()
    ((begin, waiting), (at, hint)) = printed
    assert (begin, waiting) == (100.0, "waiting for /joint_states, /commands; no topics here yet")
    assert 10.0 < at - begin < 10.3
    assert re.match(r"robot: no publisher of /joint_states, /commands on domain 7, interfaces .*; usual causes: ", hint)
    assert "another ROS_DOMAIN_ID on the robot" in hint and "multicast" in hint


@pytest.mark.parametrize("is_terminal", [False, True])
def test_messages_of_another_type_are_counted_and_printed_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, is_terminal: bool
):
    from rosbags.rosbag2 import Writer

    # the line of a terminal does not show them
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)

    kind, run = "sensor_msgs/msg/JointState", ran(FIG4)
    angles = np.hstack([run["estimator.theta_m"], run["estimator.theta_l"]])[:1000].tolist()
    with Writer(tmp_path / "bag", version=9) as writer:
        topic = writer.add_connection("/joint_states", kind, typestore=STORE)
        for k, row in enumerate(angles):
            at = 1000.0 + 0.002 * k
            right = joint_message(at, **dict(zip(("m1", "m2", "m3", "l1", "l2", "l3"), row, strict=True)))
            writer.write(topic, round(at * NS), STORE.serialize_cdr(right, kind))
            if k >= 500:
                wrong = STORE.serialize_cdr(wrench(at, 1.0), "geometry_msgs/msg/WrenchStamped")
                writer.write(topic, round(at * NS) + 1000, wrong)
    report = shadow(ROBOT, str(tmp_path / "bag"), MAP, speed=0.0, no_alarm=True, out=tmp_path / "out")
    printed = capsys.readouterr().err.splitlines()
    assert len([line for line in printed if "/joint_states" in line]) == 1, printed
    assert "500 messages could not be read" in " ".join(report.text.split())
    assert report.facts["counts"]["samples"] == 1000 and report.exit_code == 0
