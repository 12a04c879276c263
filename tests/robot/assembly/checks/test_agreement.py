"""Tables that are right by themselves and do not fit together."""

import re
from pathlib import Path

import pytest

from tests.laws.runs import EXPERIMENTS, FORCE
from tests.robot.assembly.checks.test_tasks import told
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment

EITHER = "expected either [reference] with way points or [[task]] tables"
WAY_POINTS = ("reference.t_s=[0, 1]", "reference.p_mm=[[0, 0, -90], [0, 0, -95]]")


def test_tasks_and_way_points_exclude_each_other():
    assert told("pressing", *WAY_POINTS) == [f"{EITHER}, not both"]


def test_without_tasks_and_way_points_there_is_nothing_to_do(tmp_path: Path):
    (tmp_path / "idle.toml").write_text(f'extends = "{EXPERIMENTS}/robots/massage_robot.toml"\nduration_s = 1\n')
    with pytest.raises(InputRefused, match=re.escape(EITHER)):
        load_experiment(tmp_path / "idle.toml")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("controller.mode=position", '[controller] mode = "position": tasks press; expected "force_position"'),
        ("controller.force.reference_N=5", "[controller.force] reference_N: tasks have a force of their own"),
        ("controller.force.trigger_N=0.6", "[controller.force] trigger_N: tasks have a force of their own"),
        ("controller.force.trigger_time_s=1", "[controller.force] trigger_time_s: tasks have a force of their own"),
    ],
)
def test_tasks_press_in_a_way_of_their_own(override, said):
    (sentence,) = told("pressing", override)
    assert sentence.startswith(said)


def told_without(folder, name, *blocks):
    """What is wrong with a shipped experiment without those `blocks`, runs of lines, that begin so."""
    kept = (EXPERIMENTS / f"{name}.toml").read_text()
    for block in blocks:
        before, start, after = kept.partition(block)
        assert start, f"{name}.toml has no {block}"
        kept = before + after[after.index("\n\n" if block.startswith("[") else "\n") :]
    file = folder / "experiment.toml"
    for shelf in ("experiments/robots", "fmus"):
        kept = kept.replace(f'"{shelf.removeprefix("experiments/")}/', f'"{EXPERIMENTS.parent / shelf}/')
    file.write_text(kept.replace('"scale" ', f'"{EXPERIMENTS}/bodies/scale.toml"'))
    return told(str(file.with_suffix("")))


def test_tasks_need_to_know_how_to_come_and_go_and_how_to_feel(tmp_path):
    found = told_without(tmp_path, "massage", "[approach]", "[controller.touch]", "[controller.feed_forward]")
    assert found == [
        "missing table [approach], which tasks need",
        "missing table [controller.touch], which tasks need",
        "missing table [controller.feed_forward], which tasks need",
    ]


def test_force_control_along_way_points_needs_a_force(tmp_path):
    assert told_without(tmp_path, FORCE, "reference_N") == ["[controller.force] missing key 'reference_N'"]


@pytest.mark.parametrize(
    ("name", "override"),
    [("pressing", "approach.floor_mm=-80"), (FORCE, "reference.t_s=[0, 2, 1, 3, 4, 5]")],
)
def test_a_table_with_a_mistake_is_not_said_to_be_missing(name, override):
    assert len(told(name, override)) == 1


def test_a_monitor_in_contradiction_and_a_task_out_of_reach_are_refused_together():
    found = told("pressing", "task.1.point_mm=[200, 0]", "monitor.z_min_mm=-75", "monitor.z_max_mm=-80")
    assert any(s.startswith("[monitor] z_min_mm = -75 is not below z_max_mm = -80") for s in found)
    assert any(s.startswith("[task 1] p_B = (200.0, 0.0, -130.0) mm is out of reach") for s in found)
