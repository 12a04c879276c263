"""Runs of the search that go on from a past that their process has: the findings of runs from the start."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.laws.runs import EXPERIMENTS
from twin.robot.run.runs import RunRequest, Runs
from twin.studies.falsify import judge
from twin.studies.falsify.judge import judge_run
from twin.studies.falsify.space import Space, TriedFault

SETTINGS = {"plant": {"motor_noise_deg": 0.001}}


@pytest.fixture
def pasts(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], list[Runs]]:
    """Begins the search's process anew, with room for so many pasts; its `Runs` so far are in the list."""

    def begin(most: int) -> list[Runs]:
        made: list[Runs] = []

        def runs(request: RunRequest, after: int, most: int) -> Runs:
            made.append(Runs(request, after, most))
            return made[-1]

        judge._runs.cache_clear()
        monkeypatch.setattr(judge, "MAX_PASTS", most)
        monkeypatch.setattr(judge, "Runs", runs)
        return made

    return begin


def shared(made: Sequence[Runs]) -> int:
    """Number of pasts that were run."""
    return sum(past.shared is not None and not past.shared.lacking for runs in made for past in runs._pasts)


def findings(folder: Path, tried: Sequence[TriedFault], base: dict[str, Any]) -> list[dict[str, Any]]:
    required = [("force", "always (|plant.F_ee_B| <= 18 N)"), ("seen", "always (monitor.utilisation <= 3)")]
    space = Space(base, required, (), 13_000, 0.001, None, [None], 0)
    found = []
    for wrong in tried:
        file = folder / "tried.toml"
        file.write_text(space.file(wrong, EXPERIMENTS / "pressing.toml"))
        facts = judge_run(file, None, (str(file),))
        found.append({key: value for key, value in facts.items() if key not in ("seconds", "stepping_s")})
    return found


TRIED = [
    TriedFault("", onset=0),
    TriedFault("spring_broken", "joint_2", None, 5531),
    TriedFault("sample_loss", "encoder", 0.2, 9000, seed=1),
    TriedFault("sample_loss", "encoder", 0.2, 9000, seed=2),
    TriedFault("surface_jump", "contact", 10.0, 7563),
    TriedFault("surface_jump", "contact", 10.0, 7563, body="back"),
    TriedFault("surface_jump", "contact", 5.0, 12),
    TriedFault("drive_failure", "drive_1", None, 6000),
]


def test_findings_are_those_of_runs_from_the_start(pasts: Callable[[int], list[Runs]], tmp_path: Path):
    made = pasts(8)
    found = findings(tmp_path, TRIED, {})
    # at rest and moved; the body that was asked for once has none
    assert shared(made) == 2
    pasts(0)
    assert found == findings(tmp_path, TRIED, {})


def test_another_seed_of_the_noise_is_another_past(pasts: Callable[[int], list[Runs]], tmp_path: Path):
    tried = [TriedFault("encoder_bias", "joint_encoder_1", 0.5, 5531, seed=seed) for seed in (0, 0, 1, 1)]
    made = pasts(8)
    found = findings(tmp_path, tried, SETTINGS)
    assert shared(made) == 2
    pasts(0)
    assert found == findings(tmp_path, tried, SETTINGS) and found[1] != found[3]


def test_drives_that_need_processes_share_no_past(pasts: Callable[[int], list[Runs]], monkeypatch, tmp_path: Path):
    monkeypatch.setattr(judge, "need_processes", lambda drives: True)
    made = pasts(8)
    findings(tmp_path, [TRIED[1]] * 3, {})
    assert len(made) == 1 and shared(made) == 0
