"""A folder that may not be written to, even by root: every command says so in a sentence."""

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin.cli.app import run_command_line
from twin.kernel.errors import TwinError
from twin.kernel.recording.reader import Recording

READ_ONLY = Path("/sys")

pytestmark = pytest.mark.skipif(not READ_ONLY.is_dir(), reason="needs a file system that takes no files")


@pytest.fixture(autouse=True)
def there(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The current folder is one that takes no files, so no command can make its results/ there."""
    monkeypatch.chdir(READ_ONLY)
    before = sorted(os.listdir())
    yield
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    "command",
    [
        "run FIG4 --isolate none --set duration_s=0.1",
        "run FIG4 --isolate none --set duration_s=0.1 --out mine",
        "run FIG4 --set duration_s=0.1",
        "analyse FIG4",
        "tune FIG4",
        "converge FIG4",
        "accuracy FIG4",
        "faults PRESSING",
        "sweep SWEEP",
        "drive check velocity_servo",
        "drive compare velocity_servo --experiment FIG4",
        "init my.toml",
        "schema --out my.json",
        "compare RUN RUN",
        "report RUN --out report.html",
        "report RUN RUN2",
        "export RUN --csv --rate 1 --out run.csv",
        "export RUN --mat --rate 1 --out run.mat",
        "export RUN --parquet --rate 1 --out run.parquet",
        "replay RUN",
        "identify RUN",
    ],
)
def test_it_is_one_sentence(command: str, root: Path, force_position: Recording, position: Recording) -> None:
    names = {
        "FIG4": root / "experiments/fig4_force_position.toml",
        "PRESSING": root / "experiments/pressing.toml",
        "SWEEP": root / "experiments/sweeps/stiffness_and_gain.toml",
        "RUN": force_position.path,
        "RUN2": position.path,
    }
    words = [str(names.get(word, word)) for word in shlex.split(command)]
    with pytest.raises(TwinError) as refused:
        run_command_line(words)
    assert refused.value.exit_code in (2, 3)
    assert "cannot be " in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
