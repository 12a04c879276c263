"""A draw of mutants goes on where a session left it."""

from pathlib import Path

import pytest

from tests.mutants.report import IN_ROOM, Report, commit_of

DRAW = {"seed": 7, "count": 3, "rooms": None, "commit": "0123456789abcdef"}
FIRST, SECOND = ("twin/a.py", "core/NumberReplacer", 4), ("twin/b.py", "core/AddNot", 0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "results" / "mutants.jsonl"
    report = Report(path, DRAW)
    report.note(FIRST, 12, "survived")
    report.note(SECOND, 3, "killed")
    return path


def test_the_same_draw_knows_what_was_tried(path: Path):
    assert Report(path, DRAW).outcomes == {FIRST: "survived", SECOND: "killed"}
    # and still does after it was read
    assert Report(path, DRAW).outcomes == {FIRST: "survived", SECOND: "killed"}


@pytest.mark.parametrize("changed", [{"seed": 8}, {"count": 4}, {"commit": "f" * 16}, {"rooms": ["robot"]}])
def test_another_draw_begins_anew(path: Path, changed: dict):
    assert Report(path, DRAW | changed).outcomes == {}
    assert Report(path, DRAW).outcomes == {}


def test_a_line_that_was_cut_off_is_tried_again(path: Path):
    path.write_text(path.read_text()[:-10])
    report = Report(path, DRAW)
    assert report.outcomes == {FIRST: "survived"}
    report.note(SECOND, 3, "timed out")
    assert Report(path, DRAW).outcomes == {FIRST: "survived", SECOND: "timed out"}


def test_a_draw_goes_on_at_the_commit_of_its_record(path: Path):
    asked = {key: DRAW[key] for key in ("seed", "count", "rooms")}
    assert commit_of(path, asked) == DRAW["commit"]
    assert commit_of(path, asked | {"seed": 8}) == ""
    assert commit_of(path.with_name("another"), asked) == ""


def test_a_mutant_that_survives_its_room_is_alive_until_a_law_kills_it(path: Path):
    report = Report(path, DRAW)
    report.note(FIRST, 12, IN_ROOM)
    assert report.killed == 0.5
    assert "1 survived; 1 of these are still to be tried against the laws" in report.text(1234, "2026-11-24")
    report.note(FIRST, 12, "killed")
    assert Report(path, DRAW).killed == 1.0


def test_the_text_is_what_the_page_says_of_a_draw(path: Path):
    lines = Report(path, DRAW).text(1234, "2026-11-23").splitlines()
    assert "The 3 mutants of seed 7 were drawn from 1,234 in all rooms at commit 01234567" in lines[0]
    assert "2 of them tried until 2026-11-23: 1 were killed (50%)" in lines[0]
    assert lines[-1] == "| `twin/a.py:12` | NumberReplacer 4 | |"
