"""Every yardstick whose packages are installed here holds; the table says at which commit it was made."""

import importlib
import re
from math import isfinite
from pathlib import Path

import pytest

from twin.kernel.files import read_json
from validation.__main__ import commit
from validation.trial import names, of_file, tried

LONG = ("descriptions", "ros2", "temporal_logic")
"""They take minutes even where their packages are installed."""
FEW: dict[str, dict[str, int | float]] = {"ros2": {"DURATION": 0.5}, "temporal_logic": {"FORMULAS": 5}}
"""Numbers of cases with which files of `LONG` take a second or two."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in names() if name not in LONG])
def test_a_yardstick_that_can_be_run_here_holds(name: str):
    assert [f"{one.name}: {one.remark}" for one in tried(name) if one.verdict not in ("holds", "not run")] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", FEW)
def test_a_long_yardstick_holds_for_a_few_cases(name: str, monkeypatch: pytest.MonkeyPatch):
    for count, value in FEW[name].items():
        monkeypatch.setattr(f"validation.yardsticks.{name}.{count}", value)
    assert [f"{one.name}: {one.remark}" for one in tried(name) if one.verdict not in ("holds", "not run")] == []


@pytest.mark.parametrize("name", names())
def test_a_file_of_yardsticks_can_be_read(name: str):
    assert of_file(name)


QUICK = (
    "machine",
    "ideal_velocity",
    "velocity_servo",
    "figure_4",
    "other_parts",
    "tasks",
    "adaptive",
    "past",
    "shadow",
)
"""Parts of the benchmarks that take a second or two with one round each."""


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_part_of_the_benchmarks_measures_what_it_says(name: str, monkeypatch: pytest.MonkeyPatch):
    parts = importlib.import_module("benchmarks.__main__")
    for module in vars(parts).values():
        if getattr(module, "__name__", "").startswith("benchmarks.") and hasattr(module, "ROUNDS"):
            monkeypatch.setattr(module, "ROUNDS", 1)
    found = list(parts.PARTS[name]())
    # a figure, or a reason why there is none
    assert found and all(one.remark if one.value is None else isfinite(one.value) for one in found), found


def test_every_part_of_the_benchmarks_can_be_imported_and_called():
    parts = importlib.import_module("benchmarks.__main__").PARTS
    assert len(parts) > 20 and all(map(callable, parts.values()))


def test_the_list_of_mutants_can_be_drawn(root: Path):
    pytest.importorskip("cosmic_ray", reason="only make mutants and .ci/run install it")
    from tests.mutants.mutant import possible_mutants

    assert len(list(possible_mutants(root))) > 1000


def test_the_table_says_at_which_commit_it_was_made(root: Path):
    known = r"[0-9a-f]{7,40}(-dirty)?"
    assert re.fullmatch(known, commit())
    (stated,) = re.findall(rf"at commit ({known}):", (root / "docs" / "validation.md").read_text())
    assert stated[0] == read_json(root / "docs" / "validation.json")["commit"]
    page = (root / "docs" / "validation.md").read_text()
    assert re.search(r"^On .*, at commit [0-9a-f]{7,40}: \d+ of \d+ hold", page, re.MULTILINE)
