import math
import tomllib
from typing import Any

import pytest

from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK, Fault, checked_faults, fault_table_model
from twin.robot.experiment.mistakes import toml_keys

TICK = 1e-3
BIAS = 'kind = "encoder_bias"\ntarget = "joint_encoder_2"\nonset_s = 1.5\nmagnitude_deg = -0.5\n'


def faults(*tables: str) -> tuple[tuple[Fault, ...], list[str]]:
    """Faults and mistakes of [[fault]] tables as a file says them."""
    mistakes: list[str] = []
    values: list[Any] = tomllib.loads("".join(f"[[fault]]\n{table}\n" for table in tables)).get("fault", [])
    return checked_faults(tuple(values), TICK, mistakes), mistakes


def test_times_become_ticks_and_the_magnitude_si():
    found, mistakes = faults(BIAS + "duration_s = 0.25\nseed = 3")
    assert not mistakes
    assert found == (Fault("encoder_bias", "joint_encoder_2", 1500, 1750, math.radians(-0.5), seed=3),)


def test_without_a_duration_a_fault_stays():
    (fault,), _ = faults(BIAS)
    assert fault.end == NO_END_TICK


def test_what_a_file_does_not_say_of_a_fault_is_what_a_program_does_not_say():
    (fault,), _ = faults(BIAS)
    assert fault == Fault("encoder_bias", "joint_encoder_2", 1500, magnitude=math.radians(-0.5))


def test_no_faults_are_no_mistake():
    assert faults() == ((), [])


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_every_kind_is_read_with_its_key_and_hits_its_first_target_by_default(kind):
    known = FAULT_KINDS[kind]
    text = f'kind = "{kind}"\nonset_s = 2\n'
    text += f"{known.magnitude_key} = {known.magnitudes[0]}\n" if known.magnitudes else ""
    text += "share = 0.1\n" if known.has_share else ""
    (fault,), mistakes = faults(text)
    assert not mistakes
    assert (fault.kind, fault.target, fault.onset) == (kind, known.targets[0], 2000)


@pytest.mark.parametrize("kind", [kind for kind, known in FAULT_KINDS.items() if known.magnitudes])
def test_every_magnitude_of_the_catalogue_is_within_its_bounds(kind):
    known = FAULT_KINDS[kind]
    for magnitude in known.magnitudes or ():
        share = "share = 0.1\n" if known.has_share else ""
        _, mistakes = faults(f'kind = "{kind}"\nonset_s = 2\n{known.magnitude_key} = {magnitude}\n{share}')
        assert not mistakes


BESIDE = {"ge": (0.0, -1e-6), "gt": (1.0, 0.0), "le": (0.0, 0.001)}
"""By kind of bound: how far from it a magnitude is allowed, and one beyond: a limit of speed may be 0, a factor not."""


@pytest.mark.parametrize("kind", [kind for kind, known in FAULT_KINDS.items() if known.bounds])
def test_a_magnitude_just_beyond_its_bound_is_refused(kind):
    known = FAULT_KINDS[kind]
    for bound, limit in known.bounds.items():
        magnitudes = [limit + off for off in BESIDE[bound]]
        said = [faults(f'kind = "{kind}"\nonset_s = 2\n{known.magnitude_key} = {value}')[1] for value in magnitudes]
        assert not said[0] and said[1][0].startswith(f"[[fault]] 1 {known.magnitude_key} = ")


@pytest.mark.parametrize(
    ("text", "si"),
    [
        ('kind = "sample_delay"\nmagnitude_ms = 10', 0.01),
        ('kind = "surface_jump"\nmagnitude_mm = 2', 0.002),
        ('kind = "encoder_drift"\nmagnitude_deg_per_s = 180', math.pi),
        ('kind = "joint_friction"\nmagnitude_Nm_s_per_rad = 0.05', 0.05),
        ('kind = "drive_runaway"\nmagnitude_rad_per_s = -2', -2.0),
        ('kind = "brown_out"\nmagnitude_share = 0.5', 0.5),
        ('kind = "belief_k_s"\nmagnitude_factor = 1.2', 1.2),
        ('kind = "spring_broken"', 0.0),
    ],
)
def test_the_unit_of_the_key_becomes_si(text, si):
    (fault,), _ = faults(f"{text}\nonset_s = 0")
    assert fault.magnitude == si


def test_a_ramp_belongs_to_parameters_only():
    (fault,), _ = faults('kind = "belief_k_s"\nmagnitude_factor = 1.2\nonset_s = 0\nramp_s = 0.5')
    assert fault.ramp == 500
    _, mistakes = faults(BIAS + "ramp_s = 0.5")
    assert mistakes[0].startswith("[[fault]] 1 unknown key 'ramp_s'; ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BIAS.replace("_deg", "_mm"), ["[[fault]] 1 magnitude_mm: encoder_bias takes magnitude_deg"]),
        (BIAS.replace("magnitude_deg", "magnitude"), ["[[fault]] 1 magnitude: encoder_bias takes magnitude_deg"]),
        (BIAS + "magnitude_share = 0.1", ["[[fault]] 1 magnitude_share: encoder_bias takes magnitude_deg"]),
        (
            'kind = "drive_dead"\nonset_s = 1\nmagnitude_deg = 1',
            ["[[fault]] 1 magnitude_deg: drive_dead takes no magnitude"],
        ),
        (BIAS.replace("magnitude_deg = -0.5", ""), ["[[fault]] 1 missing key 'magnitude_deg'"]),
        (BIAS.replace("onset_s = 1.5", ""), ["[[fault]] 1 missing key 'onset_s'"]),
        (BIAS.replace("1.5", "-1"), ["[[fault]] 1 onset_s = -1: expected a number >= 0"]),
        (BIAS.replace("1.5", "1.0005"), ["[[fault]] 1 onset_s: 1.0005 s is not a whole number of ticks of 0.001 s"]),
        (BIAS + "duration_s = 0", ["[[fault]] 1 duration_s = 0: expected a number > 0"]),
        (BIAS + "start = 1", ["[[fault]] 1 unknown key 'start'; did you mean 'target'?"]),
        (
            'kind = "sample_loss"\nonset_s = 1\nmagnitude_share = 1.5',
            ["[[fault]] 1 magnitude_share = 1.5: expected a number <= 1"],
        ),
        (
            'kind = "sample_delay"\nonset_s = 1\nmagnitude_ms = 1.5',
            ["[[fault]] 1 magnitude_ms: 0.0015 s is not a whole number of ticks of 0.001 s"],
        ),
        (
            BIAS.replace("joint_encoder_2", "drive_4").replace("-0.5", '"much"'),
            [
                "[[fault]] 1 target = \"drive_4\" of encoder_bias: expected 'joint_encoder_1', 'joint_encoder_2', "
                "'joint_encoder_3', 'motor_encoder_1', 'motor_encoder_2', 'motor_encoder_3', 'all encoders', "
                "'all joint encoders', 'all motor encoders'",
                '[[fault]] 1 magnitude_deg = "much": expected a number',
            ],
        ),
        (
            'kind = "encoder_glitch"\nonset_s = 1\nmagnitude_deg = 5\nshare = 0.6',
            ["[[fault]] 1 share = 0.6: expected a number <= 0.5"],
        ),
    ],
)
def test_a_mistake_is_one_clear_sentence(text, said):
    assert faults(text) == ((), said)


def test_an_unknown_kind_is_told_with_the_one_that_is_close():
    _, mistakes = faults('kind = "encoder_bais"\nonset_s = 1')
    assert len(mistakes) == 1
    assert mistakes[0].startswith("[[fault]] 1 kind = \"encoder_bais\": did you mean 'encoder_bias' or ")


def test_all_mistakes_are_told_at_once_each_with_the_number_of_its_fault():
    found, mistakes = faults(BIAS.replace("1.5", "-1"), BIAS, BIAS.replace("_deg", "_mm"))
    assert [mistake[:11] for mistake in mistakes] == ["[[fault]] 1", "[[fault]] 3"]
    assert len(found) == 1


def test_a_single_table_is_told_what_to_write():
    mistakes: list[str] = []
    assert checked_faults({"kind": "drive_dead"}, TICK, mistakes) == ()
    assert mistakes == ["[fault]: a single table; faults are an array of tables, write [[fault]]"]


def test_every_kind_has_at_most_one_key_for_its_magnitude():
    for known in FAULT_KINDS.values():
        found = [key for key in toml_keys(fault_table_model(known)) if key.startswith("magnitude")]
        assert found == ([known.magnitude_key] if known.magnitude_key else [])
