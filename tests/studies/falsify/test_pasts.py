"""Runs of the search that go on from a past that their process has: the findings of runs from the start."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.laws.runs import EXPERIMENTS
from twin.robot.run.past import SharedPast
from twin.studies.falsify import search
from twin.studies.falsify.search import PastRuns, judged
from twin.studies.falsify.space import Space, TriedFault

SETTINGS = {"plant": {"motor_noise_deg": 0.001}}


@pytest.fixture
def pasts(monkeypatch: pytest.MonkeyPatch) -> PastRuns:
    fresh = PastRuns()
    monkeypatch.setattr(search, "_pasts", fresh)
    return fresh


def findings(folder: Path, tried: Sequence[TriedFault], base: dict[str, Any]) -> list[dict[str, Any]]:
    required = [("force", "always (|plant.F_ee_B| <= 18 N)"), ("seen", "always (monitor.utilisation <= 3)")]
    space = Space(base, required, (), 13_000, 0.001, None, [None], 0)
    found = []
    for wrong in tried:
        file = folder / "tried.toml"
        file.write_text(space.file(wrong, EXPERIMENTS / "pressing.toml"))
        facts = judged(file, None, (str(file),)).facts
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


def test_findings_are_those_of_runs_from_the_start(pasts: PastRuns, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    shared = findings(tmp_path, TRIED, {})
    # at rest and moved; the body that was asked for once has none
    assert sum(not past.lacking for _, past, _ in pasts._known) == 2
    monkeypatch.setattr(search, "MOST_PASTS", 0)
    monkeypatch.setattr(search, "_pasts", PastRuns())
    assert shared == findings(tmp_path, TRIED, {})


def test_another_seed_of_the_noise_is_another_past(pasts: PastRuns, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    tried = [TriedFault("encoder_bias", "joint_encoder_1", 0.5, 5531, seed=seed) for seed in (0, 0, 1, 1)]
    shared = findings(tmp_path, tried, SETTINGS)
    assert sum(not past.lacking for _, past, _ in pasts._known) == 2
    monkeypatch.setattr(search, "MOST_PASTS", 0)
    monkeypatch.setattr(search, "_pasts", PastRuns())
    assert shared == findings(tmp_path, tried, SETTINGS) and shared[1] != shared[3]


def test_a_process_keeps_a_few_pasts_and_makes_other_runs_from_the_start(
    pasts: PastRuns, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(search, "MOST_PASTS", 1)
    made: list[SharedPast] = []
    make = SharedPast._make

    def counted(self: SharedPast, *observers: Any) -> None:
        made.append(self)
        make(self, *observers)

    monkeypatch.setattr(SharedPast, "_make", counted)
    jumps = [TriedFault("surface_jump", "contact", 5.0, 500)] * 3
    findings(tmp_path, [*[TriedFault("drive_dead", "drive_1", None, 500)] * 3, *jumps], {})
    assert len(made) == len(pasts._known) == 1
