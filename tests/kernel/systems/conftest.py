"""Small systems of the drives in fmus/, run in this process."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from tests.kernel.systems.archives import archive
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import Recording, read
from twin.kernel.systems.choice import MasterChoice
from twin.studies.systems.recorded import record_system

OF_MASTER = {one.name for one in fields(MasterChoice)}
Ran = Callable[..., tuple[Recording, dict[str, Any]]]


@pytest.fixture
def ideal(root: Path) -> Path:
    """A shaft that turns as it is told: its speed at the end of a step is the command of the step."""
    return root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu"


@pytest.fixture
def ran(tmp_path: Path, ideal: Path) -> Ran:
    """Runs a structure whose components are a.fmu, which is `ideal`, or `resources`: (recording, facts)."""
    count = 0

    def run(ssd: str, resources: dict[str, Path] | None = None, **asked: Any) -> tuple[Recording, dict[str, Any]]:
        nonlocal count
        count += 1
        file = archive(tmp_path / f"{count}.ssp", ssd, {"a.fmu": ideal} | (resources or {}))
        out = tmp_path / f"run_{count}"
        choice = MasterChoice(**{name: asked.pop(name) for name in OF_MASTER & set(asked)})
        came = record_system(DirectReporter(lambda note: None), file, choice, out, **asked)
        return read(out / "run.mcap"), came.facts

    return run
