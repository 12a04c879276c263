import pytest

from tests.laws.runs import shipped
from twin.errors import InputRefused
from twin.experiment.fault_catalogue import CATALOGUE
from twin.experiment.fault_kind import NEVER
from twin.studies.faults.case import GLITCH_SHARE, cases, known_kinds


def test_there_is_a_case_for_every_kind_magnitude_and_onset():
    made = cases(shipped("pressing"), known_kinds(()), (0.5, 5.5), None)
    assert {case.fault.kind for case in made} == set(CATALOGUE)
    assert len(made) == 2 * sum(len(known.magnitudes or (None,)) for known in CATALOGUE.values())
    assert all(case.fault.end == NEVER for case in made)


def test_a_case_is_in_si_and_ticks_and_lasts_as_long_as_asked():
    (*_, case) = cases(shipped("pressing"), ("surface_jump",), (2.0,), 0.5)
    assert case.magnitude == 10.0
    assert (case.fault.magnitude, case.fault.onset, case.fault.end) == (10e-3, 2000, 2500)
    assert case.fault.target == CATALOGUE["surface_jump"].targets[0]


def test_glitches_hit_the_share_that_the_documentation_states():
    assert {case.fault.share for case in cases(shipped("pressing"), ("encoder_glitch",), (1.0,), None)} == {
        GLITCH_SHARE
    }


def test_kinds_come_in_the_catalogues_order():
    assert known_kinds(("drive_dead", "encoder_bias")) == ("encoder_bias", "drive_dead")


def test_a_misspelt_kind_is_told_with_the_right_one():
    with pytest.raises(InputRefused, match=r"--kind drive_runway: .*did you mean 'drive_runaway'"):
        known_kinds(("drive_runway",))


@pytest.mark.parametrize(
    ("onset", "duration", "told"),
    [
        (13.0, None, r"--onset 13: outside the experiment; expected 0 <= S < 13"),
        (-1.0, None, "--onset -1: outside"),
        (1.0, 0.0, "--duration 0: a fault lasts longer"),
        (1.0005, None, "not a whole number of ticks"),
    ],
)
def test_a_time_that_cannot_be_is_one_sentence(onset, duration, told):
    with pytest.raises(InputRefused, match=told):
        cases(shipped("pressing"), ("surface_jump",), (onset,), duration)
