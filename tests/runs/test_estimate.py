from pathlib import Path

import pytest

from tests.command_line import twin
from twin.errors import InputRefused
from twin.recording.recording import Recording
from twin.runs.assembly.load import load_experiment
from twin.runs.estimate import LARGE, estimate, refuse_endless


@pytest.fixture
def fig4(root: Path) -> Path:
    return root / "experiments/fig4_force_position.toml"


def test_the_size_is_that_of_a_recording_to_a_third(fig4: Path, force_position: Recording):
    _, size = estimate(load_experiment(fig4))
    # the content of signals decides how far they compress
    assert size == pytest.approx(force_position.path.stat().st_size, rel=1 / 3)


def test_at_the_controllers_rate_half_is_estimated(fig4: Path):
    seconds, size = estimate(load_experiment(fig4))
    assert estimate(load_experiment(fig4, ["recording.rate=controller"])) == (seconds, size / 2)


def test_a_run_that_fills_the_disk_is_asked_about_before_it_begins(fig4: Path, tmp_path: Path):
    done = twin("run", fig4, "--set", "duration_s=1e7", "--isolate", "none", cwd=tmp_path)
    assert done.returncode == 2 and not any(tmp_path.iterdir())
    assert done.stderr == (
        "fig4_force_position: 1e+10 ticks take about 2.3 days and 3,500 GB; "
        "shorten duration_s, or say --yes if that is meant\n"
    )


def test_several_runs_count_together_and_pacing_counts_too(fig4: Path):
    hour = load_experiment(fig4, ["duration_s=1800", "reference.t_s=[0]", "reference.p_mm=[[0, 0, -90]]"])
    refuse_endless([hour])
    refuse_endless([hour], factor=1.0)
    with pytest.raises(InputRefused, match="60 minutes and 1 GB"):
        refuse_endless([hour], factor=0.499)
    count = int(LARGE / estimate(hour)[1]) + 1
    with pytest.raises(InputRefused, match="5 GB"):
        refuse_endless([hour] * count)


def test_a_sweep_of_endless_runs_is_asked_about_even_before_it_is_estimated(fig4: Path, tmp_path: Path):
    (tmp_path / "long.toml").write_text(f'extends = "{fig4}"\nduration_s = 1e7\n')
    (tmp_path / "sweep.toml").write_text(
        'experiment = "long.toml"\n[[vary]]\nkey = "contact.stiffness_N_per_m"\nvalues = [1000.0, 2000.0]\n'
    )
    for options in ([], ["--dry-run"]):
        done = twin("sweep", "run", "sweep.toml", *options, cwd=tmp_path)
        assert done.returncode == 2 and done.stderr.startswith(
            "sweep: each run takes about 56 hours; shorten duration_s"
        )
