"""Every yardstick whose packages are installed here holds; the table says at which commit it was made."""

import importlib
import re
from collections.abc import Iterator
from dataclasses import replace
from math import isfinite
from pathlib import Path

import pytest

from twin.kernel.files import read_json
from twin.robot.assembly.load import load_experiment
from validation.__main__ import commit
from validation.masters import master
from validation.masters import robot as robots
from validation.trial import names, of_file, tried
from validation.yardsticks import mujoco, visual_kinematics

FIG4 = robots.ROOT / "experiments" / "fig4_force_position.toml"

LONG = ("descriptions", "python_control")
"""They take minutes however few cases there are."""
FEW: dict[str, dict[str, int | float]] = {
    "mujoco": {"STATES": 5},
    "ros2": {"DURATION": 0.5},
    "temporal_logic": {"FORMULAS": 5},
    "visual_kinematics": {"POINTS": 30, "RAYS": 3},
}
"""What a file of yardsticks counts, for a second or two of work."""
BRIEF = 0.3
"""Duration (s) of runs in other masters and with the engine's robot."""

ROUNDED = 1e-9
"""Share of a signal's range that rounding may be in a brief run, in which a signal moves little."""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Yardsticks with a few cases and short runs."""
    for name, counts in FEW.items():
        for count, value in counts.items():
            monkeypatch.setattr(f"validation.yardsticks.{name}.{count}", value)
    monkeypatch.setattr(robots, "PLACE", tmp_path)
    monkeypatch.setattr(master, "robot", lambda case: robots.robot(replace(master.FIG4, duration=BRIEF)))
    monkeypatch.setattr(mujoco, "experiment", lambda: load_experiment(FIG4, [f"duration_s={BRIEF}"]))
    kept = (master._traced, mujoco.answers, mujoco.engines_run, visual_kinematics.found)
    yield
    for one in kept:
        one.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in names() if name not in LONG])
def test_a_yardstick_that_can_be_run_here_holds_for_a_few_cases(name: str, few: None):
    wrong = [
        f"{one.name}: {one.difference} {one.remark}"
        for one in tried(name)
        if one.verdict not in ("holds", "not run") and (one.difference is None or not one.difference <= ROUNDED)
    ]
    assert wrong == []


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
    pytest.importorskip("cosmic_ray", reason="only make mutants installs it")
    from tests.mutants.mutant import possible_mutants

    assert len(list(possible_mutants(root))) > 1000


def test_the_table_says_at_which_commit_it_was_made(root: Path):
    known = r"[0-9a-f]{7,40}(-dirty)?"
    assert re.fullmatch(known, commit())
    (stated,) = re.findall(rf"at commit ({known}):", (root / "docs" / "validation.md").read_text())
    assert stated[0] == read_json(root / "docs" / "validation.json")["commit"]
    page = (root / "docs" / "validation.md").read_text()
    assert re.search(r"^On .*, at commit [0-9a-f]{7,40}: \d+ of \d+ hold", page, re.MULTILINE)
