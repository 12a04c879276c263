"""A component beyond a line of 20 ms and certificates: same bits, how long a step takes, and what a cut line costs."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.endurance.delay import FAR
from tests.studies.systems.test_remote import SERVED, servo, signals, started
from twin.kernel.recording.reader import read

pytestmark = pytest.mark.endurance
DELAY = 0.020
"""s, each way."""
PORT = 8786


class Line(NamedTuple):
    """A line that is up: how to be at its near end, environment of who may use it, the relay."""

    near: Sequence[str]
    env: dict[str, str]
    relay: "subprocess.Popen[str]"


def _certificates(folder: Path) -> dict[str, str]:
    """What Dask is configured by, of a certificate that is its own authority."""
    key, cert = folder / "key.pem", folder / "cert.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=twin"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(cert)], check=True, capture_output=True)
    found = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(cert)}
    for role in ("CLIENT", "WORKER", "SCHEDULER"):
        found |= {
            f"DASK_DISTRIBUTED__COMM__TLS__{role}__{what}": str(file) for what, file in (("KEY", key), ("CERT", cert))
        }
    return found


@pytest.fixture
def line(root: Path, tmp_path: Path) -> Iterator[Line]:
    """A scheduler and a worker at its far end."""
    if not all(map(shutil.which, ("ip", "openssl"))) or not os.path.exists("/dev/net/tun"):
        pytest.skip("a delayed line needs iproute2, openssl and /dev/net/tun")
    near, far = f"twin_near_{os.getpid()}", f"twin_far_{os.getpid()}"
    with ExitStack() as ends:
        for name in (near, far):
            if subprocess.run(["ip", "netns", "add", name], capture_output=True).returncode:
                pytest.skip("a delayed line needs the right to make network namespaces")
            ends.callback(subprocess.run, ["ip", "netns", "del", name], check=False)
        relay = subprocess.Popen(
            [sys.executable, "-m", "tests.endurance.delay", near, far, str(DELAY)], cwd=root, stdout=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        ends.callback(relay.wait)
        ends.callback(relay.kill)
        assert relay.stdout is not None and relay.stdout.readline() == "up\n"
        env = os.environ | _certificates(tmp_path)
        there = ["ip", "netns", "exec", far]
        ends.enter_context(started(there, f"tls://{FAR}:{PORT}", env))
        yield Line(["ip", "netns", "exec", near], env, relay)


def _cosim(line: Line, file: Path, out: Path, *more: str, env: dict[str, str] | None = None) -> "subprocess.Popen[str]":
    command = [*line.near, sys.executable, "-m", "twin", "cosim", str(file), *SERVED, "--out", str(out), *more]
    return subprocess.Popen(command, env=env or line.env, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_beyond_a_delayed_line_it_gives_the_same_bits_and_a_cut_line_is_named_and_loses_nothing(
    line: Line, tmp_path: Path
):
    file, remote = servo(tmp_path), ("--remote", f"motor=tls://{FAR}:{PORT}")
    here = _cosim(line, file, tmp_path / "here", "--stop-s", "0.1")
    assert here.wait(300) == 0
    there = _cosim(line, file, tmp_path / "there", "--stop-s", "0.1", *remote)
    text = "".join(there.communicate(timeout=300))
    assert there.returncode == 0, text
    np.testing.assert_array_equal(signals(tmp_path / "there"), signals(tmp_path / "here"))
    cost = json.loads((tmp_path / "there" / "summary.json").read_text())["components"]["motor"]["microseconds_per_step"]
    # there and back; what else a step costs depends on how busy the machine is
    assert cost > 2e6 * DELAY
    print(f"{1e-3 * cost:.1f} ms a step")

    cut = _cosim(line, file, tmp_path / "cut", "--stop-s", "100", *remote)
    partial = tmp_path / "cut" / "run.mcap.partial"
    # a slice is recorded
    sizes = {0}
    while len(sizes) < 3:
        with pytest.raises(subprocess.TimeoutExpired):
            cut.wait(0.1)
        sizes |= {partial.stat().st_size} if partial.exists() else set()
    # from now on nothing arrives, and nobody says so
    line.relay.send_signal(signal.SIGSTOP)
    _, said = cut.communicate(timeout=120)
    assert cut.returncode == 3
    assert f"motor.fmu (motor) lost the connection to tls://{FAR}:" in said and "Traceback" not in said
    assert "no answer within 15 s in the step from t =" in said and f"Recorded until then: {partial}" in said
    ticks = len(read(partial)["motor.v"])
    assert ticks > 1
    assert f"tick {ticks - 1}." in said
    np.testing.assert_array_equal(signals(tmp_path / "cut", partial.name)[: min(ticks, 101)],
                                  signals(tmp_path / "here")[: min(ticks, 101)])  # fmt: skip


def test_who_has_no_certificate_or_one_of_another_authority_is_not_let_in(line: Line, tmp_path: Path):
    file, remote = servo(tmp_path), ("--remote", f"motor=tls://{FAR}:{PORT}")
    (tmp_path / "other").mkdir()
    for env in (dict(os.environ), os.environ | _certificates(tmp_path / "other")):
        asked = _cosim(line, file, tmp_path / "run", *remote, env=env)
        _, said = asked.communicate(timeout=120)
        assert asked.returncode == 2 and "no Dask scheduler answers there" in said and "Traceback" not in said, said
    assert not (tmp_path / "run").exists()
