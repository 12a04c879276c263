"""Commands of a robot and of its twin's controller, which may begin the force loop at another sample."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.studies.replay.logs import EXPERIMENTS
from tests.studies.shadow.false_alarms import counts
from twin.kernel.cosim.port import port_slices, width
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import LAW_OUTPUTS
from twin.studies.shadow.command_comparison import MAX_PARTING, TRIGGER_SPAN, CommandComparison

TWIN = load_experiment(EXPERIMENTS / "fig4_force_position.toml")
PERIOD, TRIGGER, N = 2e-3, 1.0, 1000
APART = 0.4
"""What the beginning of the force loop adds to the commands (rad/s)."""


def compared(differs: np.ndarray, lost: bool, cuts: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Times and compared differences, `APART` where the commands differ, of a twin whose force loop begins at 1 s."""
    t: NDArray[np.float64] = PERIOD * np.arange(N, dtype=np.float64)
    kept = np.ones(N, dtype=bool)
    kept[10:400:20] = not lost
    controller = np.zeros((N, width(LAW_OUTPUTS)))
    controller[:, port_slices(LAW_OUTPUTS)["triggered"]] = (t >= TRIGGER)[:, None]
    rows = {"controller": controller[kept], "residual/command": APART * np.outer(differs, [0.0, 1.0, -0.5])[kept]}
    comparison, t = CommandComparison(TWIN), t[kept]
    edges = [0, *cuts, len(t)]
    parts = [
        comparison.feed(t[a:b], {topic: own[a:b] for topic, own in rows.items()})["residual_command"]
        for a, b in pairwise(edges)
    ]
    return t, np.concatenate(parts)


def between(begin: float, end: float) -> np.ndarray:
    t = PERIOD * np.arange(N)
    return (t >= begin) & (t < end)


@pytest.mark.parametrize(
    ("begin", "end"), [(TRIGGER - MAX_PARTING + PERIOD, TRIGGER), (TRIGGER, TRIGGER + MAX_PARTING - PERIOD)]
)
def test_a_trigger_that_is_a_little_earlier_on_one_side_is_left_out_and_the_rest_is_compared(begin: float, end: float):
    t, found = compared(between(begin, end), lost=True)
    left_out = (t >= begin) & (t < end)
    assert np.array_equal(np.isnan(found), left_out) and not np.any(found[~left_out])


@pytest.mark.parametrize("begin", [0.5, TRIGGER], ids=["the robot's alone", "the twin's alone"])
def test_after_lost_samples_a_force_loop_that_begins_alone_ends_the_comparison(begin: float):
    t, found = compared(between(begin, 1.5), lost=True)
    assert np.array_equal(np.isnan(found), t >= begin)


def test_without_lost_samples_the_difference_is_the_controllers_and_is_compared():
    t, found = compared(between(TRIGGER, 2.0), lost=False)
    assert np.array_equal(np.isnan(found), (t >= TRIGGER) & (t < TRIGGER + TRIGGER_SPAN))
    assert np.all(found[t >= TRIGGER + TRIGGER_SPAN] == APART)


def test_a_difference_that_begins_later_than_the_force_loop_is_compared():
    t, found = compared(between(1.5, 2.0), lost=True)
    assert np.array_equal(found, APART * (t >= 1.5))


def test_it_makes_no_difference_how_the_samples_are_cut():
    for differs, lost in (
        (between(TRIGGER, 2.0), True),
        (between(0.98, TRIGGER), True),
        (between(TRIGGER, 2.0), False),
    ):
        _, whole = compared(differs, lost)
        for cuts in ((1, 2, 300), (480, 481, 482, 483, 500), tuple(range(1, 900))):
            np.testing.assert_array_equal(compared(differs, lost, cuts)[1], whole)


@pytest.mark.slow
def test_a_healthy_robot_whose_twin_triggers_on_a_lost_sample_raises_no_alarm():
    # its zeros press with 0.596 N in air, and a sample that was lost brings the twin's filter over 0.6 N
    (one,) = counts("fig4_force_position", 2344, thinned=(1,))
    assert one.blocks > 10 and one.alarms == one.rare == []
