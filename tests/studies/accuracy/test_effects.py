"""Effects are of the true robot alone, and off in every experiment that ships."""

import pytest

from tests.laws.runs import EVERY_EXPERIMENT, shipped
from twin.studies.accuracy.effects import EFFECTS, NOT_MODELLED, Effect, without_effects

EXPERIMENT = shipped()


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda one: one.name)
def test_an_effect_changes_the_plant_and_nothing_the_controller_believes(effect: Effect):
    with_it = effect.of(EXPERIMENT, EXPERIMENT)
    changed = {n for n in type(EXPERIMENT.plant).model_fields
               if getattr(EXPERIMENT.plant, n) != getattr(with_it.plant, n)}  # fmt: skip
    assert changed == set(effect.values) and effect.in_force(with_it) and not effect.in_force(EXPERIMENT)
    assert with_it.controller == EXPERIMENT.controller
    assert without_effects(with_it).plant == EXPERIMENT.plant
    assert effect.reason


def test_an_effect_that_an_experiment_has_stays_as_large_as_it_is_there():
    rubbing = shipped("fig4_position", "plant.joint_friction_Nm=0.007")
    (friction,) = (effect for effect in EFFECTS if effect.name == "joint friction")
    assert friction.of(EXPERIMENT, rubbing).plant.joint_friction == 0.007


@pytest.mark.parametrize("name", EVERY_EXPERIMENT)
def test_experiments_that_ship_have_none(name: str):
    assert not any(effect.in_force(shipped(name)) for effect in EFFECTS)


def test_what_is_not_modelled_is_less_than_what_is_worth_modelling():
    assert all(most < 0.02 and why for _, most, why in NOT_MODELLED)
