import pytest

from twin.kernel.errors import InputRefused
from twin.robot.experiment.fault import FAULT_KINDS, TARGET_GROUPS
from twin.robot.experiment.together import (
    COMMON_CAUSES,
    EQUIVALENT_FAULTS,
    FAULT_PAIRS,
    PAIR_PARTS,
    common_names,
    expects_detection,
    pair_names,
    parse_fault_set,
)

NOT_COMMON = {
    "encoder_flip": "a wiring error of one encoder, found when it is connected",
    "encoder_swap": "two channels are a group already",
    "sample_delay": "one message carries all encoders",
    "sample_jitter": "one message carries all encoders",
    "sample_loss": "one message carries all encoders",
    "controller_overrun": "one command carries all motors",
    "joint_jam": "three things caught in three gears have no one cause",
    "drive_failure": "it ends the run",
    "belief_k_s": "one belief holds for all joints",
    "belief_eta": "one belief holds for all joints",
    "stiffness_change": "there is one body",
    "surface_jump": "there is one body",
    "contact_loss": "there is one body",
    "breathing": "there is one body",
}
"""Kinds that are in no common cause, and why."""
NOT_PAIRED = {
    "encoder_bias": "as a drift that has ended",
    "encoder_quantisation": "of the large steps the deflection jumps, as alone",
    "encoder_dropout_hold": "its largest share is a stuck encoder",
    "encoder_dropout_zero": "trips at once, and the monitor then reacts as to lost messages",
    "encoder_dropout_nan": "trips at once, and the monitor then reacts as to lost messages",
    "encoder_glitch": "trips at once, and the encoder is right again",
    "encoder_flip": "trips at once",
    "encoder_swap": "trips at once, or is not seen where the angles agree",
    "sample_delay": "lost messages are longer late",
    "sample_jitter": "lost messages are longer late",
    "controller_overrun": "a command held for ever is later",
    "command_lost": "motors that stand still press less than motors that go on",
    "belief_k_s": "has the sign that presses less; eta stands for the estimator",
    "spring_broken": "trips by itself",
    "backlash_growth": "smaller than a slip",
    "joint_friction": "acts on motion only",
    "drive_freewheel": "presses less than a runaway",
    "drive_dead": "presses less than a runaway",
    "joint_jam": "presses less than a runaway",
    "drive_failure": "it ends the run",
    "drive_saturation": "presses less than a runaway; one supply for all stands for it",
    "power_off": "all drives without power do nothing else any more",
    "stiffness_change": "from one tick to the next, before any reaction, as alone",
    "contact_loss": "takes force away",
    "breathing": "is what a healthy body does",
}
"""Kinds that are in no pair, and why."""
COMMON = {cause.kind for cause in COMMON_CAUSES}
PAIRED = {part.kind for part in PAIR_PARTS}


@pytest.mark.parametrize(("chosen", "left_out"), [(COMMON, NOT_COMMON), (PAIRED, NOT_PAIRED)])
def test_every_kind_is_in_the_list_or_left_out_with_a_reason(chosen, left_out):
    assert chosen | left_out.keys() == set(FAULT_KINDS)
    assert not chosen & left_out.keys()
    assert all(len(reason) > 10 for reason in left_out.values())


@pytest.mark.parametrize("cause", COMMON_CAUSES, ids=lambda cause: f"{cause.kind} {cause.target}")
def test_a_common_cause_breaks_what_its_kind_can_break(cause):
    known = FAULT_KINDS[cause.kind]
    assert cause.target in known.targets + known.groups
    assert {cause.threshold.free, cause.threshold.contact} <= {None, 0.0, *(known.magnitudes or ())}


def test_pairs_have_one_kind_of_each_component_and_no_pair_that_is_one_fault():
    assert len({part.component for part in PAIR_PARTS}) == len(PAIR_PARTS)
    components = [tuple(part.component for part in pair) for pair in FAULT_PAIRS]
    assert len(FAULT_PAIRS) == len(PAIR_PARTS) * (len(PAIR_PARTS) - 1) // 2 - len(EQUIVALENT_FAULTS)
    assert not set(components) & EQUIVALENT_FAULTS.keys()


def test_a_group_has_members_that_are_targets_of_one_kind():
    for group, members in TARGET_GROUPS.items():
        assert any(group in known.groups and known.members(group) == members for known in FAULT_KINDS.values())
    assert FAULT_KINDS["drive_dead"].members("drive_2") == ("drive_2",)


def test_a_smaller_magnitude_than_stated_is_not_expected_and_both_signs_are_alike():
    drift = next(cause for cause in COMMON_CAUSES if cause.target == "all joint encoders" and "drift" in cause.kind)
    assert [expects_detection(drift, size, True) for size in (0.1, -0.5, 2.0, -2.0)] == [False, False, True, True]


def test_the_name_of_a_set_says_its_kinds_and_places():
    (part,) = parse_fault_set("drive_runaway@all_drives")
    assert (part.kind, part.targets) == ("drive_runaway", ("all drives",))
    assert [part.kind for part in parse_fault_set("drive_runaway+sample_loss")] == ["drive_runaway", "sample_loss"]
    for name in (*common_names(), *pair_names()):
        assert parse_fault_set(name)


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
        parse_fault_set(name)
