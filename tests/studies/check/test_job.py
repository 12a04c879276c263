"""Checks one after the other, and what an update would write."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

from tests.studies.check.files import step_file
from twin import check
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.studies.check.baseline import HistoryEntry, baseline_file, read_baseline, write_baseline
from twin.studies.check.job import CheckOutcome, Pair, check_pairs, pairs

STIFFER = "[controller.position]\nkp_per_s = 2.0"
DRIVE = "ideal_velocity"


def outcomes(folder: Path, *files: Path, reason: str = "") -> list[CheckOutcome]:
    """Of `files` with one drive; what an update would write is written."""
    notes: list[dict[str, Any]] = []
    work = [Pair(str(file), DRIVE, str(folder)) for file in files]
    check_pairs(DirectReporter(notes.append), work, "2026-01-02", reason)
    found = [TypeAdapter(CheckOutcome).validate_python(note) for note in notes]
    for outcome in found:
        if outcome.text:
            write_baseline(baseline_file(folder, Path(outcome.pair.file).stem, DRIVE), outcome.text)
    return found


def words(outcome: CheckOutcome) -> dict[str, str]:
    assert outcome.verdict is not None, outcome.failure
    return {row.name: row.word for row in outcome.verdict.rows}


def test_an_update_is_the_baseline_of_the_next_check_and_the_next_update_changes_nothing(root: Path, tmp_path: Path):
    mine, folder = step_file(root, tmp_path / "mine.toml"), tmp_path / "kept"
    (first,) = outcomes(folder, mine, reason="first")
    assert set(words(first).values()) == {"new"}
    (again,) = outcomes(folder, mine)
    assert set(words(again).values()) == {"ok"} and again.verdict and again.verdict.notes == ()
    (nothing,) = outcomes(folder, mine, reason="no reason")
    assert nothing.text == ""


def test_a_stiffer_loop_is_better_is_outside_of_the_tube_and_is_accepted_with_its_reason(root: Path, tmp_path: Path):
    mine, folder = step_file(root, tmp_path / "mine.toml"), tmp_path / "kept"
    outcomes(folder, mine, reason="first")
    step_file(root, mine, STIFFER)
    (stiffer,) = outcomes(folder, mine, reason="stiffer on purpose")
    # the rise time of a first-order loop is ln 9/kp
    assert words(stiffer)["z.rise_time"] == words(stiffer)["z.IAE"] == "better"
    assert words(stiffer)["z.tube"] == "outside"
    assert stiffer.verdict and stiffer.verdict.notes[0].startswith("the experiment's file has changed")
    history = read_baseline(folder / f"mine/{DRIVE}.toml").history
    assert history == (
        HistoryEntry(date="2026-01-02", reason="first"),
        HistoryEntry(date="2026-01-02", reason="stiffer on purpose"),
    )
    assert check(mine, baselines=folder) == []


def test_what_deviates_is_a_sentence_each(root: Path, tmp_path: Path):
    mine, folder = step_file(root, tmp_path / "mine.toml"), tmp_path / "kept"
    outcomes(folder, mine, reason="first")
    step_file(root, mine, STIFFER)
    told = [str(deviation) for deviation in check(str(mine), drive=DRIVE, baselines=str(folder))]
    assert any(text.startswith(f"mine, {DRIVE}: z.rise_time is better: 1.") for text in told)
    assert any(f"mine, {DRIVE}: z.tube is outside: " in text and " m at " in text for text in told)


def test_a_check_that_is_refused_costs_the_others_nothing(root: Path, tmp_path: Path):
    unknown = '[[measure]]\nkind = "spread"\nname = "s"\nsignal = "plant.p_C[2]"'
    whole = '[[measure]]\nkind = "spread"\nname = "s"\nsignal = "plant.p_B"'
    files = [
        step_file(root, tmp_path / "wrong.toml", unknown),
        step_file(root, tmp_path / "vector.toml", whole),
        tmp_path / "absent.toml",
        step_file(root, tmp_path / "other.toml"),
    ]
    wrong, vector, absent, other = outcomes(tmp_path / "kept", *files, reason="first")
    assert """signal = "plant.p_C[2]": no such signal; did you mean 'plant.p_B'?""" in wrong.failure
    assert "it has 3 components; expected [0] to [2]" in vector.failure
    assert "no such experiment file" in absent.failure
    assert [outcome.exit_code for outcome in (wrong, vector, absent, other)] == [2, 2, 2, 0]
    assert other.text


def test_without_a_baseline_it_says_how_one_is_made(root: Path, tmp_path: Path):
    mine = step_file(root, tmp_path / "mine.toml")
    with pytest.raises(InputRefused, match=r"no baseline of mine; accept its present values: twin check .*--update"):
        check(mine, baselines=tmp_path)


def test_what_is_checked_without_names_is_what_has_baselines(root: Path, tmp_path: Path):
    stored = tmp_path / "step_z_air"
    stored.mkdir()
    (stored / "stepper.toml").write_text((root / "tests/baselines/step_z_air/stepper.toml").read_text())
    # of another purpose
    (tmp_path / "shadow").mkdir()
    (tmp_path / "shadow" / "step_z_air.json").write_text("{}")
    (pair,) = pairs([], [], tmp_path)
    assert (Path(pair.file).name, pair.drive) == ("step_z_air.toml", "stepper")
    assert [p.drive for p in pairs([Path("other.toml")], [], tmp_path)] == ["own"]
    assert len(pairs([Path("other.toml")], ["all", "own"], tmp_path)) == 12
    with pytest.raises(InputRefused, match="no baselines there"):
        pairs([], [], tmp_path / "step_z_air" / "nothing")


def test_a_drive_that_no_experiment_finds_is_told_once_and_not_for_each_of_them(tmp_path: Path):
    with pytest.raises(InputRefused, match=r"^--drive steper: no such drive; [^\n]*$"):
        pairs([Path("one.toml"), Path("other.toml")], ["stepper", "steper"], tmp_path)


def test_in_a_clone_of_twin_the_baselines_of_somebodys_own_experiment_are_beside_it(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    clone, mine = tmp_path / "clone", tmp_path / "lab" / "mine.toml"
    for folder in ("experiments", "tests/baselines/step_z_air", "lab"):
        (clone / folder).mkdir(parents=True)
    for name in ("step_z_air", "new"):
        (clone / f"experiments/{name}.toml").touch()
    monkeypatch.setattr("twin.studies.check.baseline.PROJECT_FOLDER", clone)
    monkeypatch.setattr("twin.studies.check.baseline.is_clone", lambda: True)

    def folders(*files: object) -> list[str]:
        return [pair.folder for pair in pairs([Path(str(file)) for file in files], [], None, update=True)]

    monkeypatch.chdir(clone)
    # the tests of a clone hold what is in tests/baselines to the experiments that come with it
    assert folders("experiments/step_z_air.toml") == ["tests/baselines"]
    assert folders("experiments/new.toml", "lab/mine.toml") == ["experiments/baselines", "lab/baselines"]
    assert folders(mine) == [str(tmp_path / "lab/baselines")]
    # a folder of one's own
    monkeypatch.chdir(tmp_path)
    assert folders("clone/experiments/step_z_air.toml", mine) == ["tests/baselines"] * 2


def test_an_experiment_beside_the_folder_of_its_baselines_is_found_again(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    outcomes(Path("tests/baselines"), step_file(root, Path("mine.toml")), reason="first")
    assert pairs([], [], None) == [Pair("mine.toml", DRIVE, "tests/baselines")]
