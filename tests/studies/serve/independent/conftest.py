"""Processes of a served robot and its controller, on the loopback alone."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import Popen
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.studies.shadow.conftest import LOOPBACK, Start, processes

# the FMU builder, under the name that fmus/build.py uses
sys.path.insert(0, str(ROOT / "fmus"))
FAST_PROFILE = ROOT / "tests" / "studies" / "shadow" / "other_ends" / "fast" / "loopback.xml"


@pytest.fixture(scope="session")
def variables(worker_id: str) -> dict[str, str]:
    """Variables of processes that talk by DDS, on a domain of this test process."""
    pytest.importorskip("cyclonedds")
    domain = 60 + int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 60
    own = {"CYCLONEDDS_URI": LOOPBACK, "FASTRTPS_DEFAULT_PROFILES_FILE": str(FAST_PROFILE)}
    return {**os.environ, **own, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(ROOT)}


@pytest.fixture
def start(variables: dict[str, str]) -> Iterator[Start]:
    with processes(variables) as run:
        yield run


def serve_command(experiment: str, folder: Path, *options: str) -> list[str]:
    """Command line of a served robot, recorded in `folder`."""
    return [sys.executable, "-m", "twin", "serve", experiment, "--json", "--out", str(folder), *options]


def ended(one: Popen[str], seconds: float = 300.0, code: int = 0) -> Any:
    """Facts that a served robot printed as JSON."""
    out, err = one.communicate(timeout=seconds)
    assert one.returncode == code, err
    return json.loads(out) if out.strip().startswith("{") else {}
