import pytest

from twin.kernel.errors import InputRefused
from twin.robot.experiment.fault import CATALOGUE, GROUPS
from twin.robot.experiment.together import (
    COMMON_CAUSES,
    IMPOSSIBLE,
    NOT_COMMON,
    NOT_PAIRED,
    PAIR_PARTS,
    PAIRS,
    common_names,
    expects,
    named_set,
    pair_names,
)

COMMON = {cause.kind for cause in COMMON_CAUSES}
PAIRED = {part.kind for part in PAIR_PARTS}


@pytest.mark.parametrize(("chosen", "left_out"), [(COMMON, NOT_COMMON), (PAIRED, NOT_PAIRED)])
def test_every_kind_is_in_the_list_or_left_out_with_a_reason(chosen, left_out):
    assert chosen | left_out.keys() == set(CATALOGUE)
    assert not chosen & left_out.keys()
    assert all(len(reason) > 10 for reason in left_out.values())


@pytest.mark.parametrize("cause", COMMON_CAUSES, ids=lambda cause: f"{cause.kind} {cause.target}")
def test_a_common_cause_breaks_what_its_kind_can_break(cause):
    known = CATALOGUE[cause.kind]
    assert cause.target in known.targets + known.groups
    assert {cause.seen.free, cause.seen.contact} <= {None, 0.0, *(known.magnitudes or ())}


def test_pairs_have_one_kind_of_each_component_and_no_pair_that_is_one_fault():
    assert len({part.component for part in PAIR_PARTS}) == len(PAIR_PARTS)
    components = [tuple(part.component for part in pair) for pair in PAIRS]
    assert len(PAIRS) == len(PAIR_PARTS) * (len(PAIR_PARTS) - 1) // 2 - len(IMPOSSIBLE)
    assert not set(components) & IMPOSSIBLE.keys()


def test_a_group_has_members_that_are_targets_of_one_kind():
    for group, members in GROUPS.items():
        assert any(group in known.groups and known.members(group) == members for known in CATALOGUE.values())
    assert CATALOGUE["drive_dead"].members("drive_2") == ("drive_2",)


def test_a_smaller_magnitude_than_stated_is_not_expected_and_both_signs_are_alike():
    drift = next(cause for cause in COMMON_CAUSES if cause.target == "all joint encoders" and "drift" in cause.kind)
    assert [expects(drift, size, True) for size in (0.1, -0.5, 2.0, -2.0)] == [False, False, True, True]


def test_the_name_of_a_set_says_its_kinds_and_places():
    (part,) = named_set("drive_runaway@all_drives")
    assert (part.kind, part.targets) == ("drive_runaway", ("all drives",))
    assert [part.kind for part in named_set("drive_runaway+sample_loss")] == ["drive_runaway", "sample_loss"]
    for name in (*common_names(), *pair_names()):
        assert named_set(name)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("drive_runway+sample_loss", r"--kind drive_runway\+sample_loss: .*did you mean 'drive_runaway'"),
        ("drive_dead@all_encoders", "no group 'all_encoders' of drive_dead; there are all_drives"),
        ("breathing@all_drives", "no group 'all_drives' of breathing; there are none"),
    ],
)
def test_a_set_of_what_does_not_exist_is_refused_with_what_does(name: str, sentence: str):
    with pytest.raises(InputRefused, match=sentence):
        named_set(name)
