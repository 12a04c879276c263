"""`twin serve` around the wire: both sides in one recording, ends that leave it whole, baselines."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.command_line import Done, twin
from tests.robot.live.viewer import Viewer, address_in
from tests.studies.serve import answers
from twin.kernel.recording.reader import last_time, read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.check.baseline import read_baseline
from twin.studies.serve.session import exchange_lines

SHORT = ("--set", "duration_s=0.4")
ROOT = Path(__file__).parents[3]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Sets what the other end of the mailbox does."""
    monkeypatch.setattr("twin.studies.serve.session.WIRE_JOB", answers.JOB)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def tell(**what: object) -> None:
        monkeypatch.setenv(answers.TOLD, json.dumps(what))

    return tell


def table_of(path: Path, name: str, *settings: str, drive: str | None = None) -> str:
    """A file with the commands of an experiment's own controller, by tick."""
    run = run_in_memory(load_experiment(name, settings, drive))
    np.save(path, run.held("controller.omega_ref"))
    return str(path)


def served(tmp_path: Path, *words: object) -> Done:
    return twin("serve", *words, "--out", tmp_path / "run", cwd=tmp_path)


def test_a_run_in_lockstep_is_recorded_with_both_sides(tmp_path: Path, told: Any):
    told(table=table_of(tmp_path / "table.npy", "fig4_force_position", "duration_s=0.4"), ignores=100)
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["served"]["mode"] == "lockstep" and facts["served"]["samples"] == 201
    assert facts["served"]["samples_written"] == 201 and facts["served"]["commands_read"] == 202
    found, alone = read(tmp_path / "run" / "run.mcap"), run_in_memory(load_experiment("fig4_force_position", SHORT[1:]))
    for key in ("plant.p_B", "plant.F_ee_B", "drive/1.theta_m", "encoder.count_m", "controller.omega_ref"):
        np.testing.assert_array_equal(found[key], alone[key])
    np.testing.assert_array_equal(found["remote.omega_ref"], alone["controller.omega_ref"])
    assert found["remote.answered"].all()
    # the command that was not obeyed is there too, at its tick
    assert len(found["commands.number"]) == 202 and np.count_nonzero(found["commands.obeyed"] == 0) == 1
    ignored = np.flatnonzero(found["commands.obeyed"] == 0)
    assert found["commands.omega_ref"][ignored].tolist() == [[9.0] * 3]
    assert found.time("commands")[ignored] == pytest.approx(0.1)
    assert [(e.time, e.text) for e in found.events if e.name == "wire"] == [(0.1, "a command of somebody else")]
    assert found.metadata["served"] == {"mode": "lockstep", "irregular": "commands"} and found.complete
    assert "a remote controller commanded the drives" in found.deviations[0]
    again = twin("run", "--from", "run", cwd=tmp_path)
    assert again.returncode == 2 and "a remote controller commanded its drives" in again.stderr


def test_the_page_of_a_run_is_a_key_of_its_only_json_object(tmp_path: Path, told: Any):
    told()
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep", "--json", "--report")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["served"]["mode"] == "lockstep" and facts["page"] == "run/report.html"
    assert (tmp_path / "run" / "report.html").is_file()


def test_the_text_of_a_run_tells_of_the_exchange_and_the_wire_of_its_wait(tmp_path: Path, told: Any):
    told()
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep")
    assert done.returncode == 0 and "waiting for nobody" in done.stderr
    assert "  served     lockstep: 201 samples, 201 commands\n" in done.stdout
    assert "             answered from a table\n" in done.stdout


def test_two_runs_in_lockstep_are_the_same_bytes(tmp_path: Path, told: Any):
    told(table=table_of(tmp_path / "table.npy", "fig4_force_position", "duration_s=0.4"), ignores=150)
    for name in ("a", "b"):
        words = "serve", "fig4_force_position", *SHORT, "--lockstep", "--out", name
        assert twin(*words, cwd=tmp_path).returncode == 0
    assert (tmp_path / "a" / "run.mcap").read_bytes() == (tmp_path / "b" / "run.mcap").read_bytes()


def test_in_real_time_commands_are_recorded_when_they_arrive(tmp_path: Path, told: Any):
    told()
    done = served(tmp_path, "fig4_force_position", *SHORT, "--json", "--watchdog-ms", "200", "--silence-ms", "50")
    assert done.returncode == 0, done.stderr
    facts, found = json.loads(done.stdout), read(tmp_path / "run" / "run.mcap")
    assert facts["punctuality"]["deadlines"] > 300
    times = {"watchdog_s": "0.2", "silence_s": "0.05"}
    assert found.metadata["served"] == {"mode": "real time", **times, "irregular": "commands"} and found.complete
    t = found.time("commands")
    # the answer to the last sample comes after the last tick
    assert len(t) - facts["served"]["commands_read"] in (0, 1) and (np.diff(t) > 0.0).all()
    # each answers a sample, so it comes later than its sample and is taken by the next tick of the controller or later
    assert t[0] > 0.0 and t[-1] <= 0.5


def test_a_sample_without_an_answer_ends_the_run_with_a_whole_recording(tmp_path: Path, told: Any):
    told(gives_up=200)
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep")
    assert done.returncode == 3
    assert "remote got no answer to its sample at t = 0.2 s, tick 200" in done.stderr
    assert "The recording is complete: run/run.mcap." in done.stderr
    found = read(tmp_path / "run" / "run.mcap")
    assert found.time("plant")[-1] == pytest.approx(0.199)
    assert "got no answer" in found.events[-1].text and found.complete
    assert done.stdout.startswith("fig4_force_position  0.199 s at")


def test_a_controller_that_never_answers_ends_the_run_before_it_begins(tmp_path: Path, told: Any):
    told(gives_up=0)
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep")
    assert done.returncode == 3 and "got no answer to its sample at t = 0 s, tick 0" in done.stderr


def test_a_process_of_the_topics_that_dies_ends_the_run_with_its_reason(tmp_path: Path, told: Any):
    told(dies=100)
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep")
    assert done.returncode == 3 and "the process of the topics ended the process with exit(7)" in done.stderr
    assert "\nRecorded until then: run/run.mcap.partial (0.099 s)." in done.stderr
    assert last_time(tmp_path / "run" / "run.mcap.partial") == pytest.approx(0.099)


@pytest.mark.slow(reason="the supervisor's limit has to pass")
def test_a_supervisor_does_not_take_a_wait_for_a_hang(tmp_path: Path, told: Any, monkeypatch: pytest.MonkeyPatch):
    # longer than four times the limit, after which a call that waits counts as stuck
    told(stalls=100, seconds=6.0)
    words = "serve", "fig4_force_position", *SHORT, "--lockstep", "--limit-step", "1", "--out", tmp_path / "run"
    done = process(tmp_path, *words)
    out, said = done.communicate(timeout=120)
    assert done.returncode == 0, said
    assert "201 samples" in out


def process(tmp_path: Path, *words: object) -> "subprocess.Popen[str]":
    """`twin WORDS` as a process with its guarded process, whose topics are those of `answers`."""
    code = (
        "import twin.studies.serve.session as s, sys, os\n"
        "from twin.cli import main\n"
        f"sys.argv = {['twin', *map(str, words)]!r}\nmain()\n"
    )
    # the guarded process imports the session itself
    site = tmp_path / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(
        "import sys\n"
        "class Find:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name != 'twin.studies.serve.session':\n            return None\n"
        "        sys.meta_path.remove(self)\n"
        "        import importlib.util\n"
        "        spec = importlib.util.find_spec(name)\n"
        "        run = spec.loader.exec_module\n"
        "        def changed(module):\n"
        f"            run(module); module.WIRE_JOB = {answers.JOB!r}\n"
        "        spec.loader.exec_module = changed\n"
        "        return spec\n"
        "sys.meta_path.insert(0, Find())\n"
    )
    paths = os.pathsep.join([str(site), str(ROOT)])
    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": paths}, start_new_session=True,
    )  # fmt: skip


def hosts_of(library: str, folder: Path) -> set[str]:
    """Processes with a loaded library, of those that `process` started for a test in `folder`."""
    found = set()
    for one in Path("/proc").glob("[0-9]*"):
        # processes end meanwhile
        with contextlib.suppress(OSError):
            if str(folder).encode() in (one / "environ").read_bytes() and library in (one / "maps").read_text():
                found.add(one.name)
    return found


def wait_for(path: Path, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < deadline, path
        time.sleep(0.05)


def test_ctrl_c_ends_a_wait_in_lockstep_with_a_whole_recording(tmp_path: Path, told: Any):
    told(stalls=200, seconds=600.0)
    running = process(tmp_path, "serve", "fig4_force_position", *SHORT, "--lockstep", "--out", tmp_path / "run")
    wait_for(tmp_path / "run" / "run.mcap.partial")
    time.sleep(5.0)
    running.send_signal(signal.SIGINT)
    out, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert "interrupted; the recording is complete: run/run.mcap" in said
    assert out.startswith("fig4_force_position  0.199 s at")
    found = read(tmp_path / "run" / "run.mcap")
    assert found.time("plant")[-1] == pytest.approx(0.199)
    assert "ended by hand" in found.events[-1].text


def test_ctrl_c_in_real_time_ends_with_a_whole_recording(tmp_path: Path, told: Any):
    told()
    running = process(tmp_path, "serve", "fig4_force_position", "--out", tmp_path / "run")
    wait_for(tmp_path / "run" / "run.mcap.partial")
    time.sleep(5.0)
    running.send_signal(signal.SIGINT)
    out, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    end = read(tmp_path / "run" / "run.mcap").time("plant")[-1]
    assert 0.5 < end < 19.0 and out.startswith(f"fig4_force_position  {end:g} s at")


def wait_until_recorded(partial: Path, t: float) -> None:
    """Wait until an unfinished recording reaches the time `t` (s), at most a minute after it begins."""
    wait_for(partial)
    began = time.monotonic()
    while (last_time(partial) or 0.0) < t:
        assert time.monotonic() - began < 60.0
        time.sleep(0.1)


def test_a_killed_run_is_readable_to_its_last_second(tmp_path: Path, told: Any):
    told()
    running = process(tmp_path, "serve", "fig4_force_position", "--out", tmp_path / "run")
    partial = tmp_path / "run" / "run.mcap.partial"
    wait_until_recorded(partial, 2.0)
    before = last_time(partial) or 0.0
    time.sleep(1.5)
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    # time of the robot is time of the wall
    assert (last_time(partial) or 0.0) >= before + 0.5
    assert len(read(partial, salvage=True)["remote.age"]) > 1000


def test_a_killed_run_in_lockstep_lost_no_tenth_of_a_second_however_long_an_answer_takes(tmp_path: Path, told: Any):
    told(stalls=300)
    # few messages, which fill no chunk of the file
    few = "--set", "recording.rate=controller", "--set", "controller.period_ms=10"
    running = process(tmp_path, "serve", "fig4_force_position", *SHORT, *few, "--lockstep", "--out", tmp_path / "run")
    partial = tmp_path / "run" / "run.mcap.partial"
    wait_until_recorded(partial, 0.28)
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    assert read(partial, salvage=True).time("plant")[-1] == pytest.approx(0.29)


def test_drives_in_processes_of_their_own_move_a_served_robot_bit_for_bit(tmp_path: Path, told: Any):
    told(table=table_of(tmp_path / "table.npy", "fig4_force_position", "duration_s=0.4"), stalls=300, seconds=3.0)
    words = "serve", "fig4_force_position", *SHORT, "--lockstep", "--isolate", "drive", "--out", tmp_path / "run"
    running, hosts = process(tmp_path, *words), set[str]()
    while running.poll() is None:
        hosts |= hosts_of("velocity_servo", tmp_path)
        time.sleep(0.2)
    out, said = running.communicate(timeout=120)
    assert len(hosts) == 3
    assert running.returncode == 0, said
    assert "201 samples" in out
    found, alone = read(tmp_path / "run"), run_in_memory(load_experiment("fig4_force_position", SHORT[1:]))
    for key in ("plant.p_B", "plant.F_ee_B", "drive/1.theta_m"):
        np.testing.assert_array_equal(found[key], alone[key])


def test_a_viewer_of_a_served_robot_starts_a_fault(tmp_path: Path, told: Any):
    told()
    fault = "fault=[{kind='spring_softened', target='joint_2', onset_s=19, magnitude_factor=0.8}]"
    words = "serve", "fig4_force_position", "--set", fault, "--live", "--port", "0", "--out", tmp_path / "run"
    running = process(tmp_path, *words, "--watchdog-ms", "0")
    assert running.stderr is not None
    address = next(line for line in running.stderr if "serving ws://" in line)
    with Viewer(address_in(address)) as viewer:
        viewer.until(lambda: "/events" in viewer.channels)
        assert viewer.parameters()["fault.1.start"] is False
        viewer.subscribe("/events", "/plant")
        viewer.until(lambda: bool(viewer.messages("/plant")))
        viewer.set("fault.1.start", True)
        viewer.until(lambda: any("fault" in one.message.message for one in viewer.messages("/events")))
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    found = read(tmp_path / "run")
    onset = found.time("fault/1")[np.flatnonzero(found["fault/1.active"])[0]]
    assert 0.0 < onset < found.time("plant")[-1] < 19.0


def test_the_text_of_an_exchange_states_losses_and_latency():
    facts = {
        "mode": "real time", "samples_written": 9, "commands_read": 8, "commands": 7, "superseded": 1, "invalid": 0,
        "unanswered": 2, "lost": 3, "unwritten": 4, "ignored": {"old": 1}, "notes": ["refused"],
        "latency_ms": {"p50": 1.8, "p99": 2.4, "largest": 6.0},
    }  # fmt: skip
    assert exchange_lines(facts) == [
        "real time: 9 samples, 7 commands, 1 replaced before a tick, 2 samples without an answer, 3 samples lost, "
        "4 messages not written, 1 old",
        "from a command to the sample it moved 1.80 ms, 2.40 ms at 99 %, at most 6.00 ms",
        "refused",
    ]


@pytest.mark.parametrize(("gain", "code"), [(1.0, 0), (0.7, 1), (0.0, 1)])
def test_a_controller_is_checked_against_the_baselines(tmp_path: Path, told: Any, gain: float, code: int):
    table = table_of(tmp_path / "table.npy", "step_z_air", drive="velocity_servo")
    np.save(table, gain * np.load(table))
    told(table=table)
    words = "serve", "step_z_air", "--lockstep", "--check", "--drive", "velocity_servo", "--out", tmp_path / "run"
    done = twin(*words, cwd=ROOT)
    assert done.returncode == code, done.stderr
    assert ("All as it was: 1 experiment, 1 drive" in done.stdout) == (code == 0)
    assert ("Deviates: " in done.stdout) == (code == 1)


def test_the_run_of_another_law_becomes_a_baseline_of_its_own(tmp_path: Path, told: Any):
    table = table_of(tmp_path / "table.npy", "step_z_air", drive="velocity_servo")
    own = np.load(table)
    words = "serve", "step_z_air", "--lockstep", "--drive", "velocity_servo", "--baselines", tmp_path / "mine"
    accept = "--update", "--reason", "first"
    stored = tmp_path / "mine" / "step_z_air" / "velocity_servo.toml"
    for gain, options, code, said in (
        (0.7, accept, 0, f"  written    {stored}"),
        (0.7, ["--check"], 0, "All as it was: 1 experiment, 1 drive"),
        (1.0, ["--check"], 1, "Deviates: "),
        (1.0, accept, 0, "Deviates: "),
        (1.0, ["--check"], 0, "All as it was: 1 experiment, 1 drive"),
    ):
        np.save(table, gain * own)
        told(table=table)
        done = twin(*words, *options, "--out", tmp_path / f"run {code} {gain} {len(options)} {said[:3]}", cwd=ROOT)
        assert done.returncode == code, done.stderr
        assert said in done.stdout
    assert [entry.reason for entry in read_baseline(stored).history] == ["first", "first"]


def test_without_cyclone_dds_the_command_names_the_package(tmp_path: Path, told: Any, monkeypatch: pytest.MonkeyPatch):
    told()
    monkeypatch.setattr("twin.cli.serve.find_spec", lambda name: None)
    done = served(tmp_path, "fig4_force_position")
    assert done.returncode == 2 and "twin serve: needs cyclonedds; pip install 'twin[shadow]'" in done.stderr


def test_a_run_on_a_named_body_reports_the_height_of_its_surface(tmp_path: Path, told: Any):
    told()
    done = served(tmp_path, "fig4_force_position", *SHORT, "--lockstep", "--body", "forearm")
    assert done.returncode == 0 and "surface at z = -101.0 mm, height_mm of " in " ".join(done.stdout.split())


def test_a_watchdog_may_have_infinite_time(tmp_path: Path, told: Any):
    told()
    done = served(tmp_path, "fig4_force_position", *SHORT, "--watchdog-ms", "inf", "--silence-ms", "inf")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--check"], "--check: needs --lockstep"),
        (["--names", "a,b,c"], "--names a,b,c: expected six different names"),
        (["--command-topic", "speeds"], "--command-topic speeds: expected a topic that begins with /"),
        (["--command-topic", "/my speeds"], "--command-topic /my speeds: expected a topic that begins with /"),
        (["--lockstep", "--answer-s", "0"], "--answer-s 0: expected a time > 0 s"),
        (["--baselines", "x"], "--baselines: needs --check or --update"),
        (["--update", "--reason", "x"], "--update: needs --lockstep"),
        (["--lockstep", "--update", "--reason", "x"], "--update: expected --baselines DIR --reason"),
        (["--lockstep", "--update", "--baselines", "x"], "--update: expected --baselines DIR --reason"),
        (["--lockstep", "--reason", "x"], "--update: expected --baselines DIR --reason"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_a_sentence(tmp_path: Path, told: Any, words: list[str], said: str):
    told()
    done = served(tmp_path, "fig4_force_position", *words)
    assert done.returncode == 2 and said in done.stderr
    assert not (tmp_path / "run").exists()
