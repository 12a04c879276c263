"""What is assumed of parameters changes beliefs and nothing else."""

from math import radians

import pytest

from tests.laws.runs import shipped
from twin.studies.accuracy.uncertainty import UNCERTAINTIES, Uncertainty

EXPERIMENT = shipped()


@pytest.mark.parametrize("uncertainty", UNCERTAINTIES, ids=lambda one: one.label)
def test_only_the_controllers_belief_is_off(uncertainty: Uncertainty):
    off = uncertainty.of(EXPERIMENT)
    before, after = EXPERIMENT.controller.model, off.controller.model
    assert {n for n in type(before).model_fields if getattr(before, n) != getattr(after, n)} == set(uncertainty.names)
    assert off.plant == EXPERIMENT.plant and off.controller.force == EXPERIMENT.controller.force
    assert uncertainty.reason


def test_a_zero_is_off_at_one_joint_by_its_amount():
    second = next(one for one in UNCERTAINTIES if one.label.startswith("zero of joint encoder 2"))
    zeros = [b - a for a, b in zip(
        EXPERIMENT.controller.model.joint_zero, second.of(EXPERIMENT).controller.model.joint_zero, strict=True
    )]  # fmt: skip
    assert zeros == pytest.approx([0.0, radians(0.05), 0.0], abs=1e-15)
