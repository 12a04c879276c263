"""DDS on the loopback alone, and a domain for each test process."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE, Popen

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.studies.replay.logs import FIG4, ran

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>20</MaxAutoParticipantIndex><Peers><Peer Address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)
Start = Callable[..., Popen[str]]


@pytest.fixture(scope="session")
def domain(worker_id: str) -> int:
    """One that no other test process uses."""
    return 40 + int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 40


@pytest.fixture(scope="session")
def loopback(domain: int) -> dict[str, str]:
    """Variables of processes that talk by DDS."""
    pytest.importorskip("cyclonedds")
    return {**os.environ, "CYCLONEDDS_URI": LOOPBACK, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="session")
def angles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The six joint angles of Fig. 4, 500 a second."""
    run = ran(FIG4)
    path = tmp_path_factory.mktemp("robot") / "angles.npy"
    np.save(path, np.hstack([run["estimator.theta_m"], run["estimator.theta_l"]]))
    return path


@contextmanager
def processes(variables: dict[str, str]) -> Iterator[Start]:
    """Yield a function that starts processes with these variables, and others; they end with the block."""
    begun: list[Popen[str]] = []

    def run(*words: object, **changed: str) -> Popen[str]:
        one = Popen([*map(str, words)], stdout=PIPE, stderr=PIPE, text=True, env=variables | changed, cwd=ROOT)
        begun.append(one)
        return one

    yield run
    for one in begun:
        if one.poll() is None:
            one.kill()
        one.communicate()


@pytest.fixture
def start(loopback: dict[str, str]) -> Iterator[Start]:
    with processes(loopback) as run:
        yield run
