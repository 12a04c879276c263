"""A session served to real WebSocket clients, and the button that accepts what the twin proposes."""

import json
import re
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.live.test_live import refused
from tests.robot.live.viewer import Received, Viewer, address_in
from tests.studies.replay.logs import ANGLES, EXPERIMENTS, FIG4, ran, write_log
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS
from twin.robot.live.server import READ_ONLY_REFUSAL, LiveServer
from twin.robot.plant.component import PLANT_OUTPUTS as MOTION
from twin.studies.identify.estimate import Estimate
from twin.studies.replay.model import model_of
from twin.studies.replay.parts import Happening, Rows
from twin.studies.shadow import ACCEPT_PARAMETER, ACCEPTED_PARAMETER, LINE_PARAMETER, PROPOSAL_PARAMETER
from twin.studies.shadow.following import ALARM_LEVEL, twin_of
from twin.studies.shadow.live_view import AcceptButton, ShadowViewer
from twin.studies.shadow.mapping import wanted_signals
from twin.studies.shadow.reidentification import Adaptation, ParameterChange
from twin.studies.shadow.session import Session
from twin.studies.shadow.sources import open_source
from twin.studies.shadow.study import shadow

ROBOT = EXPERIMENTS / f"{FIG4}.toml"
ADDRESS = re.compile(r"serving (ws://127\.0\.0\.1:\d+/\?token=[\w-]{22}); viewers may come and go\n")
TOPICS = {"estimator": ESTIMATOR_OUTPUTS, "plant": MOTION, "alarm": (ALARM_LEVEL,)}


class OneProposal:
    """A twin that proposes a spring, until that is accepted."""

    def __init__(self) -> None:
        spring = ParameterChange(
            "k_s of joint 2", "k_s_share", 1, 1.0, Estimate(0.93, 0.02, "N m/rad"), "N m/rad", 0.02
        )
        self.proposal: Adaptation | None = Adaptation(14.5, (spring,))
        self.adaptations: list[Adaptation] = []

    def accept(self, proposal: Adaptation, /) -> bool:
        if proposal is not self.proposal:
            return False
        self.proposal = None
        self.adaptations.append(proposal)
        return True


def platform(drawn: Received, frame: str) -> list[float]:
    (found,) = [one.translation for one in drawn.message.transforms if one.child_frame_id == frame]  # type: ignore[attr-defined]
    return [found.x, found.y, found.z]


@pytest.mark.slow
def test_viewers_that_come_go_or_do_not_read_see_both_robots_and_change_nothing_of_what_is_recorded(tmp_path: Path):
    log = ran(FIG4).path
    shadow(ROBOT, str(log), speed=0.0, duration_s=2.5, out=tmp_path / "alone")
    words = [
        "--source",
        str(log),
        "--duration-s",
        "2.5",
        "--out",
        str(tmp_path / "seen"),
        "--live",
        "--port",
        "0",
        "--report",
    ]
    command = [sys.executable, "-m", "twin", "shadow", str(ROBOT), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        address = ADDRESS.fullmatch(process.stderr.readline())
        assert address
        with Viewer(address[1]) as watcher, Viewer(address[1]) as leaving, Viewer(address[1]) as silent:
            for viewer in (watcher, leaving, silent):
                viewer.until(lambda viewer=viewer: "/events" in viewer.channels)  # type: ignore[misc]
                viewer.subscribe(*viewer.channels)
            leaving.until(lambda: bool(leaving.messages("/plant")))
            leaving.socket.socket.shutdown(socket.SHUT_RDWR)
            # nor does a page that may not watch
            assert refused(address[1], origin="http://evil.example") == 403
            watcher.to_the_end()
        out, err = process.communicate(timeout=60)
    assert "refused: a page of http://evil.example" in err
    assert f"page       {tmp_path / 'seen' / 'report.html'}" in out and (tmp_path / "seen" / "report.html").is_file()
    alone, seen = read(tmp_path / "alone"), read(tmp_path / "seen")
    n = min(len(alone["encoder.count_m"]), len(seen["encoder.count_m"]))
    assert n > 1250 and seen.complete
    for key in ("encoder.count_l", "estimator.p_B", "shadow.p_B", "controller.omega_ref"):
        assert alone[key][:n].tobytes() == seen[key][:n].tobytes(), key
    # the robot by its counts, and the twin's model beside it
    for topic, frame, key in (("/tf", "platform", "estimator.p_B"), ("/plant/tf", "plant/platform", "plant.p_B")):
        times = seen.time(key.partition(".")[0])
        for drawn in watcher.messages(topic)[1:]:
            row = int(np.searchsorted(times, 1e-9 * drawn.time + 5e-10)) - 1
            assert platform(drawn, frame) == seen[key][row].tolist()
    (scene,) = watcher.messages("/scene")
    frames = {entity.frame_id for entity in scene.message.entities}  # type: ignore[attr-defined]
    assert frames >= {"platform", "plant/platform", "surface"} and "plant/base" not in frames
    assert watcher.messages("/residual/joints") and watcher.messages("/shadow")


def test_accept_takes_the_token_and_an_open_proposal_and_follows_it_once():
    twin: Any = OneProposal()
    told = list[str]()
    proposal, text = twin.proposal, "k_s of joint 2 was 1.000, is 0.930 +- 0.020 N m/rad"
    values = {"text": text, "field": "k_s_share", "leg": 1, "value": 0.93, "half_width": 0.02, "unit": "N m/rad"}
    with LiveServer(0, told.append, waits=False) as server:
        viewer = ShadowViewer(server, TOPICS, load_experiment(ROBOT), twin)
        rows = {"alarm": np.array([[np.nan], [0.25]])}
        address = address_in(told[0])
        with Viewer(address) as owner, Viewer(address.partition("?")[0]) as stranger:
            owner.subscribe("/alarm", "/events", "/estimator")
            owner.send(op="subscribeParameterUpdates", parameterNames=[])
            assert owner.parameters() == {
                ACCEPT_PARAMETER: False,
                PROPOSAL_PARAMETER: text,
                ACCEPTED_PARAMETER: "[]",
                LINE_PARAMETER: "",
            }
            stranger.set(ACCEPT_PARAMETER, True)
            stranger.until(lambda: bool(stranger.of("parameterValues", id="set")))
            assert [one["message"] for one in stranger.of("status")] == [READ_ONLY_REFUSAL]
            assert viewer.press() == ""
            owner.set(ACCEPT_PARAMETER, True)
            owner.until(lambda: bool(owner.of("parameterValues", id="set")))
            (answer,) = owner.of("parameterValues", id="set")
            assert answer["parameters"] == [{"name": ACCEPT_PARAMETER, "value": True}]
            assert twin.adaptations == []
            assert (viewer.press(), viewer.press()) == ("", "")
            assert twin.adaptations == [proposal]
            viewer.show(np.array([0, 2_000_000]), rows, [Happening(0.002, text)])
            # what happens while nothing comes is seen, too
            viewer.show(np.array([], dtype=np.int64), {}, [Happening(1.002, "nothing has come for 1 s")])
            owner.until(lambda: len(owner.messages("/events")) == 2)
            texts = [one.message.message for one in owner.messages("/events")]  # type: ignore[attr-defined]
            assert texts == [text, "nothing has come for 1 s"]
            assert owner.messages("/alarm")[-1].message.level == 0.25  # type: ignore[attr-defined]
            heard = [one["parameters"] for one in owner.of("parameterValues") if "id" not in one]
            assert {"name": ACCEPT_PARAMETER, "value": True} in heard[0]
            accepted = {"name": ACCEPTED_PARAMETER, "value": json.dumps([values])}
            assert [
                {"name": ACCEPT_PARAMETER, "value": False},
                {"name": PROPOSAL_PARAMETER, "value": ""},
                accepted,
            ] in heard
            viewer.say("12.3 s  500 Hz")
            line = [{"name": LINE_PARAMETER, "value": "12.3 s  500 Hz"}]
            owner.until(lambda: line in [one["parameters"] for one in owner.of("parameterValues")])


def test_a_port_that_is_taken_is_refused_before_the_robot_is_waited_for(tmp_path: Path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputRefused, match=f"--port {port}: .*choose another one, or 0"):
            shadow(ROBOT, str(ran(FIG4).path), live=True, port=port, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        (ACCEPT_PARAMETER, True, "there is no proposal to accept"),
        (ACCEPT_PARAMETER, 1.0, "expected true, which accepts what shadow.proposal says"),
        (ACCEPT_PARAMETER, "yes", "expected true"),
        ("shadow.acept", True, "did you mean 'shadow.accept'?"),
        (PROPOSAL_PARAMETER, "k_s = 2", "shadow.accept = true accepts what shadow.proposal says"),
        (ACCEPTED_PARAMETER, "[]", "shadow.accepted is set by the twin"),
    ],
)
def test_what_is_no_acceptance_is_refused_in_a_sentence(name: str, value: object, expected: str):
    nothing: Any = OneProposal()
    nothing.proposal = None
    with pytest.raises(InputRefused, match=re.escape(expected)):
        AcceptButton(nothing).request(name, value)


def test_what_was_accepted_is_that_proposal_and_not_a_later_one():
    twin: Any = OneProposal()
    button = AcceptButton(twin)
    button.request(ACCEPT_PARAMETER, True)
    twin.proposal = Adaptation(20.0, ())
    assert (button.press() or "").startswith("not accepted, for it is not open any more: k_s of joint 2")
    button.request(ACCEPT_PARAMETER, True)
    button.request(ACCEPT_PARAMETER, False)
    assert button.press() is None and twin.adaptations == []


class Onlooker:
    """In place of a `ShadowViewer`: what it was shown."""

    def __init__(self) -> None:
        self.samples, self.texts, self.asked = 0, list[str](), ["not accepted, for it is not open any more: k_s"]

    def say(self, line: str) -> None:
        pass

    def press(self) -> str:
        return self.asked.pop() if self.samples > 100 and self.asked else ""

    def show(self, times: np.ndarray, rows: Rows, happened: list[Happening]) -> None:
        self.samples += len(times)
        self.texts += [one.text for one in happened]


def test_a_session_shows_every_slice_and_all_that_happens_and_records_that_too(tmp_path: Path):
    experiment = load_experiment(ROBOT)
    model, onlooker = model_of(experiment), Onlooker()
    wanted = wanted_signals(model.belief)
    run = ran(FIG4)
    there = np.flatnonzero((run.time("estimator") < 0.5) | (run.time("estimator") > 1.0))[:1000]
    log = write_log(tmp_path / "log.csv", run, angles=True)
    head, *lines = log.read_text().splitlines()
    log.write_text("\n".join([head, *(lines[k] for k in there)]))
    robot, _, of_now = open_source(str(log), column_map(ANGLES), wanted, model.belief, 10.0, [])
    twin = twin_of(experiment, model, "robot")
    viewer: Any = onlooker
    session = Session(robot, {}, wanted, twin, model, 0.03, np.inf, of_now, lambda text: None, viewer=viewer)
    session.wait_for_topics()
    followed = session.follow(lambda: tmp_path / "run.mcap")
    assert onlooker.samples == followed.counts.samples == 1000
    recorded = [event.text for event in read(followed.recording).events]
    assert onlooker.texts == recorded and len(recorded) == 3
    assert "not accepted, for it is not open any more: k_s" in recorded
    line = session.line()
    assert re.fullmatch(r"2\.5 s  500 Hz  late 0 ms  251 missing in 1 gap  NIS 0\.\d+  joints 0\.00\d deg", line), line
