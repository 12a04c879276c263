"""Components beside a Dask worker: same bits, and what goes wrong there is named here."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from tests.command_line import twin
from tests.kernel.systems.archives import archive, component, connection, structure, system
from tests.kernel.systems.linear import Linear
from tests.kernel.systems.test_loops import WIRES, masses
from tests.kernel.systems.test_tolerance import CASES as TOLERANCES
from tests.kernel.systems.test_tolerance import Case, made, ssd
from twin.kernel.cosim.delay import play
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent, opened
from twin.kernel.fmi.description import described
from twin.kernel.fmi.solvers import Solver
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setup
from twin.kernel.process.hosted import DONE, ENDED, HostedFmu
from twin.kernel.process.job import error_of
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import Recording, read
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice, remote
from twin.kernel.systems.naming import port_of
from twin.studies.systems.recorded import recorded_system

SERVED = ("--tick-ms", "1", "--input", "pi.u=step(0.02)")
MOTOR = Linear(a=[[0.0, 1.0], [0.0, -10.0]], b=[[0.0, 0.0], [1e4, -1e4]], c=[[1.0, 0.0], [0.0, 1.0]])


def servo(folder: Path, motor: Linear = MOTOR) -> Path:
    """A PI and a motor, which turns as `pi.u` says."""
    loop = Linear(a=[[0.0]], b=[[1.0, -1.0]], c=[[1.0]], d=[[0.02, -0.02]]).fmu(folder / "pi.fmu")
    wires = [connection("motor.v", "pi.w"), connection("pi.y", "motor.u")]
    ssd = structure(system([component("pi", "pi.fmu"), component("motor", "motor.fmu")], wires), 0.2)
    return archive(folder / "servo.ssp", ssd, {"pi.fmu": loop, "motor.fmu": motor.fmu(folder / "motor.fmu")})


def signals(run: Path, name: str = "run.mcap") -> np.ndarray:
    """What is recorded of `servo` (ticks, 4)."""
    recording = read(run / name)
    return np.column_stack([recording[f"{one}"] for one in ("pi.y", "pi.v", "motor.y", "motor.v")])


@contextmanager
def started(there: Sequence[str], address: str, env: Mapping[str, str]) -> Iterator[list["subprocess.Popen[str]"]]:
    """A scheduler at `address` and a worker of it, by commands after `there`; [scheduler, worker]."""
    protocol, _, rest = address.partition("://")
    host, _, port = rest.partition(":")
    common = ["--host", host, "--no-dashboard"]
    dask = [*there, sys.executable, "-m"]
    commands = (
        [*dask, "distributed.cli.dask_scheduler", *common, "--port", port, "--protocol", protocol],
        [*dask, "distributed.cli.dask_worker", address, *common, "--nthreads", "1", "--no-nanny"],
    )
    running: list[subprocess.Popen[str]] = []
    try:
        for command, up in zip(commands, ("Scheduler at:", "Registered to:"), strict=True):
            running.append(subprocess.Popen(command, env=dict(env), stderr=subprocess.PIPE, text=True))
            log = running[-1].stderr
            assert log is not None and any(up in line for line in log), command
        yield running
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()


@pytest.fixture
def cluster() -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Address of the scheduler, and the worker."""
    pytest.importorskip("distributed")
    address = f"tcp://127.0.0.1:{20000 + os.getpid() % 20000}"
    with started([], address, os.environ) as (_, worker):
        yield address, worker


def ran(file: Path, out: Path, **asked: Any) -> dict[str, Any]:
    choice = MasterChoice(tick=1e-3, **asked)
    added = Additions(inputs=["pi.u=step(0.02)"])
    return recorded_system(DirectReporter(lambda note: None), file, choice, out, additions=added).facts


@pytest.mark.slow
def test_beside_a_worker_it_gives_the_same_bits_and_a_worker_that_dies_is_named_and_loses_nothing(
    cluster: tuple[str, "subprocess.Popen[str]"], tmp_path: Path
):
    address, worker = cluster
    file = servo(tmp_path)
    ran(file, tmp_path / "here")
    facts = ran(file, tmp_path / "there", remote={"motor": address})
    np.testing.assert_array_equal(signals(tmp_path / "there"), signals(tmp_path / "here"))
    assert facts["components"]["motor"]["remote"] == address and "remote" not in facts["components"]["pi"]

    ended = ran(servo(tmp_path, Linear(ends_at=0.05, **_matrices(MOTOR))), tmp_path / "e", remote={"motor": address})
    assert ended["simulated_s"] == pytest.approx(0.05) and "motor" in ended["ended"]

    asked = subprocess.Popen(
        [sys.executable, "-m", "twin", "cosim", str(servo(tmp_path)), *SERVED, "--stop-s", "1000",
         "--remote", f"motor={address}", "--out", str(tmp_path / "cut")], stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    partial = tmp_path / "cut" / "run.mcap.partial"
    while not (partial.exists() and partial.stat().st_size > 20_000):
        assert asked.poll() is None, asked.communicate()
        time.sleep(0.05)
    worker.kill()
    _, said = asked.communicate(timeout=60)
    assert asked.returncode == 3 and "Traceback" not in said, said
    assert re.search(r"motor.fmu \(motor\) lost the connection to tcp://127.0.0.1:\d+: .* in the step from t =", said)
    assert f"tick {len(read(partial)['motor.v']) - 1}." in said and "Recorded until then" in said
    with pytest.raises(InputRefused, match=r"--remote .*no workers; start some with: dask worker"):
        ran(file, tmp_path / "late", remote={"motor": address})


@pytest.mark.slow
def test_loops_tolerances_equations_and_states_there_have_the_bits_of_here(
    cluster: tuple[str, "subprocess.Popen[str]"], tmp_path: Path
):
    address, _ = cluster

    def packed(case: Case) -> Path:
        return archive(tmp_path / "x.ssp", ssd(case, 0.1), made(case, tmp_path))

    def recorded(file: Path, out: str, start_from: str | None = None, **asked: Any) -> Recording:
        hear, choice = DirectReporter(lambda note: None), MasterChoice(**asked)
        recorded_system(hear, file, choice, tmp_path / out, state_every=0.03, start_from=start_from)
        return read(tmp_path / out / "run.mcap")

    # one that takes lines, and equations that CVODE solves there; both are set back
    for name, far, asked in (
        ("stiff", "a", {"tolerance": 1e-3, "tick": 2e-4}),
        ("two tanks", "b", {"tolerance": 1e-4, "tick": 1e-3, "kinds": {"": "model_exchange"}}),
    ):
        file = packed(TOLERANCES[name])
        here, there = (recorded(file, f"{name} {one}", remote=one, **asked) for one in ({}, {far: address}))
        assert "master.step" in there.fields()
        for signal_name in here.fields():
            np.testing.assert_array_equal(there[signal_name], here[signal_name])
    # a loop of one that reacts and one that goes back, both there; its state goes from here to there, and back
    loop: dict[str, Any] = {"tick": 1e-3, "loops": "solve", "kinds": {"mass": "model_exchange"}, "solver": "rk4"}
    file = packed((masses(2.0, 6.0), WIRES))
    whole, last = recorded(file, "here", **loop), 0
    for out, start_from, far_ones in (
        ("there", "here@0.03", {"mass": address, "load": address}),
        ("back", "there@0.06", dict[str, str]()),
    ):
        run = recorded(file, out, str(tmp_path / start_from), **loop, remote=far_ones)
        first = round(run.time("mass")[0] / 1e-3)
        assert first > last
        for signal_name in ("mass.y", "mass.v", "load.y"):
            np.testing.assert_array_equal(run[signal_name], whole[signal_name][first:])
        last = first


def _matrices(one: Linear) -> dict[str, Any]:
    return {name: getattr(one, name) for name in "abcd"}


@pytest.mark.parametrize(
    ("address", "said"),
    [
        (
            "tcp://10.0.0.5:8786",
            "tcp leaves this machine unencrypted, and anybody who reaches that port can run code there",
        ),
        ("tcp://8.8.8.8:8786", "give tls://"),
        ("tcp://name:8786", "expected NAME=tls://HOST:PORT"),
        ("10.0.0.5", "expected NAME=tls://HOST:PORT"),
        ("ws://127.0.0.1:8786", "expected NAME=tls://HOST:PORT"),
    ],
)
def test_only_this_machine_or_certificates_are_taken(tmp_path: Path, address: str, said: str):
    with pytest.raises(InputRefused, match=re.escape(said)):
        ran(servo(tmp_path), tmp_path / "run", remote={"motor": address})
    assert not (tmp_path / "run").exists()


def test_options_that_contradict_each_other_or_mean_nothing_are_refused(tmp_path: Path):
    for text in ("motor", "=tls://h:1", "motor="):
        with pytest.raises(InputRefused, match="expected COMPONENT=tls"):
            remote([text])
    with pytest.raises(InputRefused, match="--remote mot: no such component; did you mean 'motor'"):
        ran(servo(tmp_path), tmp_path / "run", remote={"mot": "tcp://127.0.0.1:8786"})


def test_the_limit_of_a_call_is_that_of_other_machines_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def machines(remote: Mapping[str, str], limit: float) -> NoReturn:
        raise InputRefused(f"{remote} within {limit:g} s")

    monkeypatch.setattr("twin.studies.systems.remote.machines", machines)
    remotely = ("--remote", "motor=tcp://127.0.0.1:1", "--limit-step", "7")
    done = twin("cosim", servo(tmp_path), *SERVED, *remotely, cwd=tmp_path)
    assert done.returncode == 2 and "{'motor': 'tcp://127.0.0.1:1'} within 7 s" in done.stderr


@pytest.mark.slow
def test_the_process_of_a_worker_gives_the_bits_of_this_one_and_its_end_is_told(tmp_path: Path):
    file = MOTOR.fmu(tmp_path / "motor.fmu")
    description = described(file)
    inputs, outputs = ([FmuPort(port_of(v, "m"), v) for v in description.offered(side)] for side in ("input", "output"))
    setup = Setup(step=1e-3, waiting=True)
    host = HostedFmu(10.0)
    order = {"name": "m", "kind": "co_simulation", "values": {}, "settings": [], "setup": setup}
    outcome, came = host.make(file.read_bytes(), "motor.fmu", **order)
    assert outcome == DONE and came["missing"] == []
    u = description.variables["u"]
    assert host.call("write", settings=[(u, 3.0)]) == (DONE, None)
    assert np.frombuffer(bytes.fromhex(host.call("read", variables=[u])[1])) == [3.0]
    outcome, started_with = host.call("begin", name="m", inputs=inputs, outputs=outputs, settings=[], solver=Solver())
    here = opened("m", description, unpacked(file, description.sha256), (), (), setup)
    here.begin()
    own = FmuComponent("m", description, here.folder, inputs, outputs, setup=setup, instance=here)
    assert started_with["y"] == own.initial_outputs.tobytes().hex()
    given = np.random.default_rng(1).normal(size=(50, 2))
    rows, _ = play(own, 1e-3 * np.arange(50.0), np.full(50, 1e-3), given)
    for k in range(50):
        u_there = given[k].tobytes().hex()
        outcome, came = host.call("step", t=1e-3 * k, h=1e-3, u=u_there, before=[], reacts=False)
        assert (outcome, came["status"], came["y"]) == (DONE, 0, rows[k].tobytes().hex())
    own.close()
    # what it raises is raised here, and its process has ended
    outcome, report = host.call("step", t=0.0, h=1e-3, u="no number", before=[], reacts=False)
    assert outcome == "failed" and isinstance(error_of(report), ComponentFailed)
    assert host.call("read", variables=[u]) == (ENDED, "has ended")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "told"), [(signal.SIGSEGV, "crashed (SIGSEGV"), (signal.SIGSTOP, "did not return within 0.5 s")]
)
def test_an_fmu_that_crashes_or_hangs_ends_its_own_process_and_the_worker_can_say_so(
    tmp_path: Path, what: signal.Signals, told: str
):
    file = MOTOR.fmu(tmp_path / "motor.fmu")
    host = HostedFmu(0.5)
    order = {"name": "m", "kind": "co_simulation", "values": {}, "settings": [], "setup": Setup(step=1e-3)}
    assert host.make(file.read_bytes(), "motor.fmu", **order)[0] == DONE
    assert host._process is not None
    os.kill(host._process.pid, what)
    outcome, how = host.call("read", variables=[described(file).variables["u"]])
    assert outcome == ENDED and how.startswith(told)
