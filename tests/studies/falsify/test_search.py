"""The race and the evolution on a robot of which it is known what breaks it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.together import common_names, ordered_names, pair_names
from twin.studies.falsify.search import Search
from twin.studies.falsify.space import Space, TriedFault
from twin.studies.falsify.study import DEFAULT_RUNS

TICKS = 13_000
WORST_ONSET = 9_000
ONSETS = (5_500, 500)


def space(*kinds: str, bodies: Sequence[str | None] = (None,)) -> Space:
    return Space({}, [], kinds or tuple(FAULT_KINDS), TICKS, 0.001, None, bodies, 0)


def share(wrong: TriedFault) -> float:
    """Two kinds violate: one everywhere if it is large, and most at one time; one only early."""
    if wrong.kind == "surface_jump":
        assert wrong.magnitude is not None
        return 1.0 - 0.15 * min(wrong.magnitude, 10.0) + abs(wrong.onset - WORST_ONSET) / TICKS
    if wrong.kind == "encoder_drift":
        return 0.5 if wrong.onset > 2_000 else -0.2
    return 1.0


def searched(
    runs: int, where: Space | None = None, of: Callable[[TriedFault], float] = share, onsets: Sequence[int] = ONSETS
) -> Search:
    search = Search(where or space(), lambda batch: [of(wrong) for wrong in batch], runs, onsets)
    search.spend_runs()
    return search


def test_a_search_makes_as_many_runs_as_it_may_and_none_twice():
    for runs in (32, 40, 106):
        # fewer only where nothing is left to be found out
        assert len(searched(runs).tried) == runs


def test_every_kind_is_tried_before_any_is_tried_again():
    first = list(searched(106).tried)[: len(FAULT_KINDS)]
    assert [wrong.kind for wrong in first] == list(FAULT_KINDS)
    assert all(wrong.magnitude == (FAULT_KINDS[wrong.kind].magnitudes or (None,))[-1] for wrong in first)


def test_what_violates_only_early_is_found_in_the_second_round():
    search = searched(106)
    assert search.worst["encoder_drift"][1] == -0.2
    assert list(search.tried).index(search.worst["encoder_drift"][0]) < 50


def test_runs_that_are_left_go_to_where_it_is_worst():
    few, many = (searched(runs).worst["surface_jump"] for runs in (50, 160))
    assert many[1] < few[1]
    assert many[1] == pytest.approx(-0.5, abs=0.1)
    assert abs(many[0].onset - WORST_ONSET) < abs(few[0].onset - WORST_ONSET)


def test_the_same_search_is_the_same():
    assert searched(106).tried == searched(106).tried


def test_by_default_every_kind_is_tried_at_each_target_and_with_each_sign():
    search = searched(DEFAULT_RUNS, of=lambda wrong: 1.0)
    been = {(wrong.kind, search.space.place(wrong)) for wrong in search.tried}
    assert been == {(kind, place) for kind in FAULT_KINDS for place in search.space.places(kind)}
    assert len(search.tried) <= DEFAULT_RUNS


@pytest.mark.parametrize(
    ("kind", "target", "way"),
    [("drive_dead", "drive_2", 1), ("encoder_bias", "motor_encoder_3", -1), ("belief_k_s", "estimator", -1)],
)
def test_a_fault_that_violates_at_one_target_or_with_one_sign_only_is_found(kind: str, target: str, way: int):
    where = space()

    def of(wrong: TriedFault) -> float:
        violates = wrong.kind == kind and wrong.target == target and where.place(wrong).ways == (way,)
        return -1.0 if violates else 1.0

    found, nearest = searched(DEFAULT_RUNS, of=of).worst[kind]
    assert nearest == -1.0 and (found.target, where.place(found).ways) == (target, (way,))


def test_with_few_runs_every_kind_has_one_and_the_nearest_have_more():
    few = searched(40, of=lambda wrong: 0.1 if wrong.kind == "drive_dead" else 1.0)
    assert {wrong.kind for wrong in few.tried} == set(FAULT_KINDS)
    assert len({wrong.target for wrong in few.tried if wrong.kind == "drive_dead"}) > 1


def test_the_nearer_half_of_what_has_been_everywhere_goes_to_other_times_and_smaller_magnitudes():
    """Not the very nearest, to which evolution goes."""
    nearness = {"breathing": 0.5, "contact_loss": 0.6, "sample_delay": 0.7, "brown_out": 0.8}

    def of(wrong: TriedFault) -> float:
        inside = wrong.kind == "contact_loss" and wrong.onset not in ONSETS and wrong.magnitude != 20.0
        return -1.0 if inside else nearness[wrong.kind]

    search = searched(40, space(*nearness), of)
    assert search.worst["contact_loss"][1] == -1.0
    # Halton's sequence in base 2: a quarter of the run, three quarters; between half the way and the upper end
    race = [wrong for wrong in list(search.tried)[8:11] if wrong.kind == "breathing"]
    assert [wrong.onset for wrong in race] == [round(share * (TICKS - 1)) for share in (0.25, 0.75)]
    middle = search.space.magnitude("breathing", 0.5)
    assert middle is not None and all(middle <= (wrong.magnitude or 0.0) < 25.0 for wrong in race)
    assert any((wrong.magnitude or 0.0) > 5.0 for wrong in race)


def test_evolution_goes_to_where_the_other_sign_is_worse():
    """From +2 deg/s, which just violates, to below -1 deg/s: the race itself has no run left to go there."""

    def of(wrong: TriedFault) -> float:
        assert wrong.magnitude is not None
        return -0.1 + 0.2 * wrong.magnitude if wrong.magnitude < 0.0 else -0.1

    worst, nearest = searched(40, space("encoder_drift"), of).worst["encoder_drift"]
    assert nearest < -0.3 and worst.magnitude is not None and worst.magnitude < -1.0


def test_each_run_of_a_noisy_robot_has_a_seed_of_its_own():
    """Of one kind: what differs in it is where, when and how large, and the noise."""
    where = replace(space("drive_dead"), noisy=True)
    tried = searched(6, where, of=lambda wrong: 1.0).tried
    assert sorted(wrong.seed for wrong in tried)[:4] == [0, 1, 2, 3]


def test_bodies_take_turns_and_the_worst_one_is_found():
    def on_body(batch: Sequence[TriedFault]) -> list[float]:
        return [-1.0 if wrong.body == "back" else -0.5 for wrong in batch]

    search = Search(space("breathing", bodies=(None, "back")), on_body, 20, (5_500, 500))
    search.spend_runs()
    assert [wrong.body for wrong in search.tried][:2] == [None, "back"]
    assert search.worst["breathing"][0].body == "back"


def test_only_what_is_drawn_at_random_gets_other_seeds():
    seeds = {wrong.seed for wrong in searched(106).tried if wrong.kind == "encoder_drift"}
    assert seeds == {0}
    random = searched(20, space("sample_loss")).tried
    assert len({wrong.seed for wrong in random}) > 3


def test_a_planted_pair_that_no_single_fault_shows_is_found_among_all_pairs_in_its_direction():
    """It presses only if the encoder drifts one way and the belt slips the other."""

    def of(wrong: TriedFault) -> float:
        if wrong.kind != "encoder_drift+belt_slip":
            return 1.0
        drift, slip = wrong.shares
        return 0.5 + drift * slip

    single = searched(DEFAULT_RUNS, of=of)
    assert min(share for _, share in single.worst.values()) == 1.0
    found, nearest = searched(DEFAULT_RUNS, space(*pair_names()), of).worst["encoder_drift+belt_slip"]
    assert nearest < -0.4 and math.prod(found.shares) < -0.9


def test_each_axis_of_a_common_cause_has_a_direction_of_its_own():
    worst = (1.0, -1.0, 0.5)

    def of(wrong: TriedFault) -> float:
        if wrong.kind != "drive_runaway@each_drive":
            return 1.0
        return 0.1 + sum(abs(share - each) for share, each in zip(wrong.shares, worst, strict=True))

    search = searched(400, space(*common_names()), of)
    found, nearest = search.worst["drive_runaway@each_drive"]
    assert nearest < 0.4 and [math.copysign(1.0, share) for share in found.shares] == [1.0, -1.0, 1.0]
    assert found.target == "drive_1+drive_2+drive_3"


def test_offsets_are_searched_for_the_worst_within_reach():
    where = replace(space("breathing"), reach=0.02)

    def of(wrong: TriedFault) -> float:
        x, y = wrong.offset
        return -0.1 + math.hypot(x + 0.012, y - 0.008) / 0.02

    search = searched(80, where, of)
    found, nearest = search.worst["breathing"]
    assert nearest < 0.0 and math.hypot(found.offset[0] + 0.012, found.offset[1] - 0.008) < 0.002
    assert all(math.hypot(*wrong.offset) <= 0.0201 for wrong in search.tried)


def test_a_second_fault_is_searched_at_every_delay_and_down_to_drives_that_creep():
    """It presses only as a slow second fault, about 1.7 s after the trip."""
    kind = "sample_loss-then-drive_runaway@all_drives"

    def of(wrong: TriedFault) -> float:
        speed = search_space.magnitude(kind, wrong.shares[1], 1)
        assert speed is not None
        return abs(0.001 * wrong.delay - 1.7) + abs(math.log10(abs(speed) / 0.1)) - 0.3

    search_space = space(kind)
    search = searched(200, search_space, of)
    found, nearest = search.worst[kind]
    assert nearest < 0.0 and kind in ordered_names()
    speeds = [search_space.magnitude(kind, wrong.shares[1], 1) or 0.0 for wrong in search.tried]
    assert min(map(abs, speeds)) < 0.06 and max(map(abs, speeds)) > 8.0
    delays = {wrong.delay for wrong in search.tried}
    assert min(delays) < 100 and max(delays) > 2900 and search_space.first_alone(found).delay == 0


def test_a_search_goes_beyond_the_largest_magnitude_of_the_catalogue():
    """It violates only at 20 deg/s, ten times the catalogue's largest drift."""

    def of(wrong: TriedFault) -> float:
        return abs(math.log10(abs(wrong.magnitude or 1.0) / 20.0)) - 0.3

    found, nearest = searched(60, space("encoder_drift"), of).worst["encoder_drift"]
    assert nearest < 0.0 and 10.0 < abs(found.magnitude or 0.0) < 40.0
