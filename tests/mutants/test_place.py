"""A mutant is tried in a tree of its own: one that a test notices is killed, another one survives."""

import subprocess
from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray", reason="the extra mutants, which only make mutants and .ci/run ask for")

from tests.mutants.mutant import possible_mutants
from tests.mutants.place import Place

pytestmark = pytest.mark.slow
ROOM = "robot/mechanism"
FILES = {
    f"twin/{ROOM}/part.py": "def noticed():\n    return 1\n\n\ndef unnoticed():\n    return 2\n",
    f"tests/{ROOM}/test_part.py": (
        "from twin.robot.mechanism.part import noticed, unnoticed\n\n\n"
        "def test_it():\n    assert noticed() == 1\n    unnoticed()\n"
    ),
    "twin/__init__.py": "",
    "twin/kernel/__init__.py": "",
    "twin/robot/__init__.py": "",
    f"twin/{ROOM}/__init__.py": "",
}


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """The tree of a repository with one module and one test."""
    repository = tmp_path / "repository"
    for name, text in FILES.items():
        (repository / name).parent.mkdir(parents=True, exist_ok=True)
        (repository / name).write_text(text)
    who = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run(["git", *who, *words], cwd=repository, check=True)
    (tmp_path / "place").mkdir()
    return Place(repository, tmp_path / "place", "HEAD")


def test_a_mutant_that_a_test_notices_is_killed_and_the_source_is_as_before(place: Place):
    place.warm([ROOM])
    outcomes: dict[int, set[str]] = {}
    for mutant in possible_mutants(place.root):
        if mutant.operator == "core/NumberReplacer":
            outcomes.setdefault(mutant.line, set()).add(place.tried(mutant, ROOM))
    assert outcomes == {2: {"killed"}, 6: {"survived"}}
    assert (place.root / f"twin/{ROOM}/part.py").read_text() == FILES[f"twin/{ROOM}/part.py"]
