from pathlib import Path

import pytest

from twin.errors import InputRefused
from twin.experiment.started import start_experiment
from twin.runs.assembly.declared import DECLARED


@pytest.mark.parametrize(
    ("file", "start", "said"),
    [
        ("a.toml", "taping", "--from taping: no such experiment; did you mean 'tapping'?"),
        ("a.toml", "xyz", "--from xyz: no such experiment; known are calibration, "),
        ("a.yaml", "tapping", "a.yaml: expected a name that ends with .toml"),
        ("/proc/nowhere/a.toml", "tapping", "/proc/nowhere: cannot be created"),
    ],
)
def test_what_cannot_be_started_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, start: str, said: str
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputRefused) as refusal:
        start_experiment(DECLARED, Path(file), start)
    assert str(refusal.value).startswith(said)
    assert not list(tmp_path.iterdir())
