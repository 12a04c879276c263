"""A run served to real WebSocket clients: one run, in which everything happens that viewers do."""

import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus

from tests.robot.live.viewer import Viewer
from twin.kernel.recording.reader import Recording, read
from twin.robot.live.server import MESSAGE_INTERVAL

FIG4 = "experiments/fig4_force_position.toml"
REFERENCE = "controller.force.reference_N"
DRAWN = ("tf", "scene", "force")
OUT_OF_BOUNDS = (1e308, 50.5, 0, True, "7", None, [5], 10**400)
HOSTILE = (
    b"\x01binary",
    "",
    "no JSON",
    "[" * 60_000,
    json.dumps({"op": "advertise", "channels": []}),
    json.dumps({"op": ["subscribe"]}),
    json.dumps({"op": "subscribe", "subscriptions": {"id": -1}}),
    json.dumps({"op": "subscribe", "subscriptions": [{"id": 2**40, "channelId": 1}]}),
    json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}),
    json.dumps({"op": "getParameters", "parameterNames": [7]}),
    json.dumps({"op": "setParameters", "parameters": "all"}),
)
"""What no viewer says; each is answered by a sentence."""


HELD = """
import sys
from twin.cli import main
from twin.robot.live.server import LiveServer

show = LiveServer.show

def held(self, first, rows, events):
    show(self, first, rows, events)
    if first == 0 or any("triggered" in event.text for event in events):
        sys.stdin.readline()

LiveServer.show = held
main()
"""
"""`twin`, whose run waits for a line of standard input behind its first slice and behind the one that triggers: what
happens then does not depend on how fast anybody is."""


class Served(NamedTuple):
    """A command that serves a run, and the address."""

    process: "subprocess.Popen[str]"
    address: str

    def go_on(self) -> None:
        """Let a run that is `HELD` go on."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def end(self) -> tuple[str, str]:
        """What it has printed, and on standard error, once it has ended by itself."""
        return self.process.communicate(timeout=60)


@contextmanager
def served(root: Path, folder: Path, *arguments: str, twin: Sequence[str] = ("-m", "twin")) -> Iterator[Served]:
    """`twin run --live` on a free port; it is gone in the end, whatever happens."""
    command = [sys.executable, *twin, "run", str(root / FIG4), "--live", "--port", "0", "--out", "x", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=folder, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stderr is not None
            said = process.stderr.readline()
            address = re.match(r"serving (ws://127\.0\.0\.1:\d+/\?token=[\w-]{22}); the run begins when a viewer", said)
            assert address, said
            yield Served(process, address[1])
        finally:
            process.kill()


def refused(address: str, origin: str) -> int:
    """The HTTP status with which a connection as from a page of `origin` to `address` is refused."""
    with pytest.raises(InvalidStatus) as refusal, Viewer(address, origin):
        pass
    return refusal.value.response.status_code


@dataclass
class Watched:
    """What came of it: facts and errors printed, viewers, parameters before the change, recording.

    `stranger` and `loud` have no token; `kept_out` says how connections from elsewhere ended.
    """

    facts: dict
    errors: str
    watcher: Viewer
    second: Viewer
    stranger: Viewer
    loud: Viewer
    kept_out: list[int]
    before: dict[str, float]
    recording: Recording


@pytest.fixture(scope="module")
def watched(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    """Fig. 4 at ten times real time: a watcher turns knobs, a second one looks on, a third vanishes; others attack."""
    folder = tmp_path_factory.mktemp("live")
    with served(root, folder, "--realtime=10", "--json", "--isolate=none", twin=("-c", HELD)) as run:
        yield watched_run(run, folder)


def watched_run(run: Served, folder: Path) -> Watched:
    address = run.address
    open_to_all = address.partition("?")[0]
    elsewhere = open_to_all.replace("127.0.0.1", "evil.example")
    kept_out = [
        refused(address, origin="http://evil.example"),
        # what a frame without rights of its own says, on any page
        refused(address, origin="null"),
        # a name of somebody else's for our address
        refused(elsewhere, origin="http://localhost:8080"),
    ]
    with (
        Viewer(address) as watcher,
        Viewer(address) as second,
        Viewer(address) as third,
        Viewer(open_to_all, origin="http://localhost:8080") as stranger,
        Viewer(f"{open_to_all}?token=guessed") as loud,
    ):
        # what is announced last
        watcher.until(lambda: "/events" in watcher.channels)
        before = watcher.parameters()
        second.subscribe("/controller")
        second.send(op="subscribeParameterUpdates", parameterNames=[REFERENCE])
        third.subscribe("/plant", "/estimator")
        stranger.subscribe("/controller")
        loud.subscribe("/plant")
        watcher.subscribe(*watcher.channels)
        for viewer in (second, third, stranger, loud, watcher):
            # answered after the subscription, so that is in force
            viewer.parameters()
        run.go_on()
        watcher.until(lambda: any("triggered" in event.message.message for event in watcher.messages("/events")))
        third.until(lambda: bool(third.messages("/plant")))
        # no goodbye: what a laptop does that is closed
        third.socket.socket.shutdown(socket.SHUT_RDWR)
        second.subscribe("/scene")
        second.parameters()
        loud.until(lambda: bool(loud.messages("/plant")))
        for said in HOSTILE:
            loud.socket.send(said)
        loud.until(lambda: len(loud.of("status")) > len(HOSTILE))
        loud.socket.send("x" * 100_000)
        loud.to_the_end()
        watcher.set(REFERENCE, 6)
        for value in OUT_OF_BOUNDS:
            watcher.set(REFERENCE, value)
        watcher.set(REFERENCE, -1)
        watcher.set("controller.force.reference", 4)
        watcher.set("controller.position.kp_per_s", "fast")
        watcher.parameters()
        stranger.set(REFERENCE, 19)
        stranger.parameters()
        run.go_on()
        for viewer in (watcher, second, stranger):
            viewer.to_the_end()
        stdout, stderr = run.end()
        assert run.process.returncode == 0, stderr
        recording = read(folder / "x" / "run.mcap")
        facts = json.loads(stdout, parse_constant=pytest.fail)
        return Watched(facts, stderr, watcher, second, stranger, loud, kept_out, before, recording)


@pytest.mark.slow
def test_every_recorded_topic_is_announced_with_its_schema_and_units(watched: Watched):
    channels = watched.watcher.channels
    recorded = {signal_name.partition(".")[0] for signal_name in watched.recording.fields()}
    assert {topic.removeprefix("/") for topic in channels} == {*recorded, *DRAWN, "events"}
    assert {(c["encoding"], c["schemaEncoding"]) for c in channels.values()} == {("protobuf", "protobuf")}
    assert channels["/plant"]["schemaName"] == "twin.Plant"
    assert channels["/plant"]["metadata"]["p_B"] == "m; platform position in base frame B"


@pytest.mark.parametrize(
    "signal_name", ["plant.p_B", "controller.F_z", "encoder.count_l", "scale.F_z", "estimator.valid"]
)
def test_what_a_viewer_sees_is_what_is_recorded_at_that_time(watched: Watched, signal_name: str):
    topic, name = signal_name.split(".")
    received = watched.watcher.messages(f"/{topic}")
    times = np.array([each.time for each in received])
    recorded = np.rint(watched.recording.time(topic) * 1e9).astype(int)
    # what is sampled stays valid until the next sample
    rows = np.searchsorted(recorded, times, side="right") - 1
    shown = np.array([getattr(each.message, name) for each in received])
    assert np.array_equal(shown, watched.recording[signal_name][rows])


def test_the_robot_is_drawn_where_the_plant_is(watched: Watched):
    plants = {each.time: each.message for each in watched.watcher.messages("/plant")}
    drawn = watched.watcher.messages("/tf")
    assert len(drawn) == len(plants)
    for each in drawn:
        (platform,) = [t for t in each.message.transforms if t.child_frame_id == "platform"]
        where = platform.translation
        assert [where.x, where.y, where.z] == list(plants[each.time].p_B)
        assert platform.timestamp.ToNanoseconds() == each.time


def test_the_scene_comes_once_with_the_first_picture_and_to_those_who_come_later(watched: Watched):
    (scene,) = watched.watcher.messages("/scene")
    assert {entity.frame_id for entity in scene.message.entities} >= {"base", "platform", "surface"}
    assert scene.time == watched.watcher.messages("/tf")[0].time
    # also where others have it already
    assert len(watched.second.messages("/scene")) == 1


def test_time_runs_forward_from_the_beginning_to_the_end(watched: Watched):
    # the run waited for its first subscription
    assert watched.second.messages("/controller")[0].time == 0
    times = [each.time for each in watched.watcher.messages("/plant")]
    assert times == sorted(set(times))
    assert times[-1] == watched.watcher.times[-1] == 20_000_000_000


def test_a_topic_has_at_most_50_messages_per_second_of_the_clock(watched: Watched):
    taken = 20.0 / watched.facts["punctuality"]["achieved"]
    # besides the first row and the last one
    assert len(watched.second.messages("/controller")) <= 2 + taken / MESSAGE_INTERVAL


def test_parameters_are_told_in_the_units_of_their_keys(watched: Watched):
    assert watched.before == {
        REFERENCE: 5.0,
        "controller.force.kp_mm_per_N": 2.0,
        "controller.force.ki_mm_per_N_s": 0.5,
        "controller.position.kp_per_s": 1.5,
    }


def test_a_new_force_reference_is_answered_acted_upon_and_recorded(watched: Watched):
    answer = watched.watcher.of("parameterValues", id="set")[0]
    assert answer["parameters"] == [{"name": REFERENCE, "value": 6.0, "type": "float64"}]
    (event,) = [event for event in watched.recording.events if event.name == "tuning"]
    assert event.text == f"{REFERENCE}: 5 -> 6 (live)"
    time, reference = watched.recording.time("controller"), watched.recording["controller.F_z_ref"]
    assert set(reference[time < event.time]) == {5.0}
    assert set(reference[time >= event.time]) == {6.0}
    pressing = -watched.recording["plant.F_ee_B"][:, 2]
    # droop of the drives and backlash leave 0.12 N of 5 N; with 5 N as reference it would end at 4.88 N
    assert pressing[-1] == pytest.approx(6.0, abs=0.25)
    assert event.text in [each.message.message for each in watched.watcher.messages("/events")]


def test_the_summary_says_that_the_run_was_changed_and_how_it_was_paced(watched: Watched):
    assert watched.facts["changed"]
    assert watched.recording.metadata["changed"]["first"] == f"{REFERENCE}: 5 -> 6 (live)"
    told = watched.facts["punctuality"]
    assert told["factor"] == 10.0
    # of 20,000 ticks those that are 1 ms of wall time apart
    assert told["deadlines"] == 2000
    # never ahead of the clock by more than the rounding of times
    assert told["achieved"] <= 10.0 + 1e-6


def test_a_bad_value_is_refused_with_a_sentence_and_the_run_goes_on(watched: Watched):
    said = [status["message"] for status in watched.watcher.of("status")]
    assert "refused: [controller.force] reference_N = -1: expected a number > 0" in said
    assert any(f"did you mean '{REFERENCE}'?" in text for text in said)
    # the value that it keeps, so that the viewer does not go on showing the refused one
    kept = [each["parameters"] for each in watched.watcher.of("parameterValues", id="set")]
    refused_ones = 1 + len(OUT_OF_BOUNDS)
    assert kept[1 : 1 + refused_ones] == refused_ones * [[{"name": REFERENCE, "value": 6.0, "type": "float64"}]]
    assert watched.recording["plant.p_B"].shape == (20_001, 3)


def test_a_second_viewer_sees_the_same_and_hears_of_the_change(watched: Watched):
    told = [(p["name"], p["value"]) for m in watched.second.of("parameterValues") for p in m["parameters"]]
    assert (REFERENCE, 6.0) in told
    seen = [(each.time, each.message.SerializeToString()) for each in watched.second.messages("/controller")]
    watched_too = [(each.time, each.message.SerializeToString()) for each in watched.watcher.messages("/controller")]
    # who has subscribed first has seen more of the beginning
    assert seen[-len(watched_too) :] == watched_too
    assert {each.topic for each in watched.second.received} == {"/controller", "/scene"}


def test_a_viewer_that_vanishes_does_no_harm(watched: Watched):
    assert watched.recording.complete


def test_a_page_of_another_origin_or_under_another_name_is_not_let_in(watched: Watched):
    assert watched.kept_out == [403, 403, 403]
    told = [line for line in watched.errors.splitlines() if line.startswith("refused: ")]
    assert told[0] == (
        "refused: a page of http://evil.example: not an origin that may watch; --origin http://evil.example lets it in"
    )
    assert "null" in told[1]
    assert "Host evil.example" in told[2]


def test_without_the_token_one_may_watch_and_not_tune(watched: Watched):
    stranger = watched.stranger
    assert stranger.messages("/controller")[-1].time == 20_000_000_000
    (told,) = stranger.of("status")
    assert "watches only" in told["message"] and "token" in told["message"]
    # the value that holds; nobody but the watcher has moved it
    (kept,) = stranger.of("parameterValues", id="set")
    assert kept["parameters"] == [{"name": REFERENCE, "value": 6.0, "type": "float64"}]
    assert [event.text for event in watched.recording.events if event.name == "tuning"] == [
        f"{REFERENCE}: 5 -> 6 (live)"
    ]


def test_a_token_of_another_run_is_told_to_be_one(watched: Watched):
    assert watched.loud.of("status")[0]["message"] == "the token belongs to another run: watching only"


@pytest.mark.parametrize("value", ["1e+308", "50.5"])
def test_what_is_out_of_bounds_is_refused_with_the_bound(watched: Watched, value: str):
    said = [status["message"] for status in watched.watcher.of("status")]
    assert f"refused: [controller.force] reference_N = {value}: expected a number <= 50" in said


def test_what_no_viewer_says_is_answered_by_a_sentence_each(watched: Watched):
    told = [status["message"] for status in watched.loud.of("status")]
    assert len(told) == 1 + len(HOSTILE)
    assert all("\n" not in text and len(text) < 300 for text in told)


def test_a_message_too_large_ends_that_connection_only(watched: Watched):
    assert watched.loud.socket.close_code == 1009
    last = watched.loud.messages("/plant")[-1].time
    assert last < watched.stranger.messages("/controller")[-1].time == 20_000_000_000


def test_ctrl_c_while_it_waits_for_a_viewer_ends_it(root: Path, tmp_path: Path):
    with served(root, tmp_path) as run, Viewer(run.address) as viewer:
        viewer.until(lambda: "/plant" in viewer.channels)
        run.process.send_signal(signal.SIGINT)
        _, stderr = run.end()
    assert run.process.returncode == 130
    assert "interrupted" in stderr
    assert "Traceback" not in stderr


def test_a_run_in_a_process_of_its_own_is_seen_from_its_first_state_to_its_last(root: Path, tmp_path: Path):
    with served(root, tmp_path, "--realtime=0", "--set", "duration_s=0.1") as run:
        assert refused(run.address, origin="http://evil.example") == 403
        with Viewer(run.address) as viewer:
            viewer.subscribe("/plant")
            viewer.to_the_end()
        _, stderr = run.end()
    assert run.process.returncode == 0
    times = [each.time for each in viewer.messages("/plant")]
    assert (times[0], times[-1]) == (0, 100_000_000)
    assert "refused: a page of http://evil.example" in stderr
