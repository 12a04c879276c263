from dataclasses import replace

import numpy as np
import pytest

from tests.studies.tune.corners import fig4_corners
from twin.studies.tune import search
from twin.studies.tune.corner import Corner
from twin.studies.tune.gains import LawGains, rounded
from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import predicted
from twin.studies.tune.search import best_gains, cost, misses, worst_misses

FIG4 = LawGains(1.5, 2e-3, 0.5e-3)


# made when a test asks for them: whoever only collects tests need not compile what they take
def air() -> tuple[Corner, ...]:
    return fig4_corners()[1:2]


def soft_and_stiff() -> tuple[Corner, ...]:
    """In air, on the softest and on the stiffest."""
    return fig4_corners()[1:6:2]


def test_the_best_gain_in_air_is_the_largest_that_keeps_the_margin():
    goals = Goals(law="position")
    found = best_gains(air(), goals, FIG4)
    assert found[1:] == FIG4[1:]
    assert not list(misses(predicted(air()[0], found), goals))
    # 5 % more is too much: nothing else than the margin limits it
    more = found._replace(kp=1.05 * found.kp)
    assert [miss.goal for miss in misses(predicted(air()[0], more), goals)] == ["margin"]


def test_the_same_search_finds_the_same_gains():
    goals = Goals(law="position")
    assert best_gains(air(), goals, FIG4) == best_gains(air(), goals, FIG4)


def test_gains_for_soft_and_stiff_meet_the_goals_on_both_and_are_faster(monkeypatch):
    # something is left to find, but this is quicker
    monkeypatch.setattr(search, "GENERATIONS", 15)
    goals = Goals()
    found = best_gains(soft_and_stiff(), goals, FIG4)
    before, after = ([predicted(corner, gains) for corner in soft_and_stiff()] for gains in (FIG4, found))
    assert worst_misses(after, goals) == []
    assert cost(after, goals) < cost(before, goals)
    assert found == rounded(found)


def test_a_force_that_jumps_near_its_end_and_then_creeps_costs_more_than_one_that_gets_there():
    made = predicted(soft_and_stiff()[2], FIG4)
    # 4 % off for 8 s, inside the band from 20 ms on
    creeping = replace(made, answers={"force": replace(made.answers["force"], settling=0.02, error=0.32)})
    arriving = replace(made, answers={"force": replace(made.answers["force"], settling=0.1, error=0.1)})
    assert cost([creeping], Goals()) > cost([arriving], Goals())


def test_every_missed_goal_costs_more_than_any_slowness_and_instability_most():
    def price(gains: LawGains, goals: Goals) -> float:
        return cost([predicted(corner, gains) for corner in soft_and_stiff()], goals)

    slow = price(FIG4, Goals())
    without_bandwidth, without_margin = price(FIG4, Goals(bandwidth=100.0)), price(FIG4, Goals(sensitivity=1.01))
    unstable = price(FIG4._replace(kp=30.0), Goals())
    assert slow < without_bandwidth < without_margin < unstable


def test_misses_are_told_where_they_are_worst():
    predictions = [predicted(corner, FIG4) for corner in soft_and_stiff()]
    (miss,) = worst_misses(predictions, Goals(bandwidth=100.0))
    # the softest surface has the slowest force loop
    assert miss.goal == "bandwidth" and miss.at is predictions[1]
    assert miss.reached == pytest.approx(min(p.answers["force"].bandwidth for p in predictions[1:]))
    assert np.isfinite(miss.by)
