"""Fig. 4's robot in the hand, judged once."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.controller.pid import Gains
from twin.robot.controller.task_controller import set_hold_point
from twin.robot.experiment.experiment import with_model, with_plant
from twin.robot.run.shared_prefix import simulate_variants
from twin.studies.analyse.linear.hand import (
    DRIFT_RATE,
    EMPTY_HAND,
    FreePlant,
    Hand,
    hand_of,
    hertz,
    linear_plant,
    power_share,
    robot_with,
)
from twin.studies.analyse.linear.loops import LOOPS, linear_law
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.nudge import NUDGE_TIME, holding_experiment
from twin.studies.analyse.operating_point import OperatingPoint, resting_point, undisturbed_experiment
from twin.studies.analyse.passivity import Passivity, passivity
from twin.studies.analyse.rendering import VIRTUAL_STIFFNESS, WIDTH_FREQUENCIES, largest_passive
from twin.studies.analyse.text import passivity_result
from twin.studies.command import ignore_progress


@pytest.fixture(scope="module")
def fig4() -> Passivity:
    return passivity(shipped(), True, ignore_progress)


@pytest.mark.slow
def test_the_force_loop_is_passive_along_z_and_the_position_law_nowhere(fig4: Passivity):
    for point in fig4.points:
        assert point.stable
        assert (point.bands["z"] is None) == point.point.force_on
        for axis in ("x", "y", "all"):
            found = point.bands[axis]
            # a spring behind a position law turns back what it gets below the robot's own swing
            assert found is not None and found.low < 0.03 and 2.0 < found.high < 12.0


@pytest.mark.slow
def test_no_more_than_the_springs_is_rendered_passively_and_nearly_that_is(fig4: Passivity):
    assert fig4.width is not None
    rendered, virtual, damping = fig4.width.largest
    assert 0.9 * fig4.width.spring < rendered <= fig4.width.spring
    # the droop of the drives takes some of what is asked for
    assert virtual > rendered and damping > 0.0


def test_soft_and_damped_is_passive_and_stiff_with_little_damping_unstable(fig4: Passivity):
    assert fig4.width is not None
    least = fig4.width.least
    assert least[-1, 0] > 0.0 and np.isnan(least[0, -1]) and least[-1, -1] < 0.0


def test_it_swings_with_a_mass_and_the_co_simulation_agrees_just_inside_and_just_outside(fig4: Passivity):
    assert all(point.worst.growth > DRIFT_RATE and point.worst.mass > 1.0 for point in fig4.points)
    trial = fig4.trial
    assert trial is not None and trial.agrees
    assert trial.predicted[0] < 0.0 < trial.predicted[1]
    # encoders, drives and coupling are the same; the nudge is not infinitely small
    np.testing.assert_allclose(trial.simulated, trial.predicted, atol=0.04)


def test_the_text_fits_80_columns_and_says_the_verdict_first(fig4: Passivity):
    lines = passivity_result(fig4).text.splitlines()
    assert lines[0] == "fig4_force_position  passive in the hand at 0 of 5 operating points"
    assert max(map(len, lines)) <= 80
    assert "the co-simulation agrees" in " ".join(line.strip() for line in lines)


def test_the_largest_passive_stiffness_is_bisected_from_the_map():
    row = np.array([1.0] * 10 + [-1.0] * 18)
    found = largest_passive(lambda stiffness: 300.0 - stiffness, row)
    assert found == pytest.approx(300.0, rel=1e-3)
    assert largest_passive(lambda stiffness: 1.0, np.full(28, np.nan)) == 0.0


DAMPING, MASS = 100.0, 0.5
"""Virtual damping (N s/m); of what is in the hand (kg)."""
INSIDE, OUTSIDE = 0.95, 1.05
NUDGE, LONG = 3e-4, 20.0
"""m, s."""
AIR = undisturbed_experiment(shipped(), height=-0.15)
"""Fig. 4 with its scale far below."""
PRESSED_B = (0.0, 0.02, -0.105)
"""m. Where Fig. 4 presses."""
KP = AIR.controller.position.kp


def at_rest(mass: float) -> OperatingPoint:
    parameters = plant_parameters(AIR.plant, AIR.contact)
    return resting_point("air", parameters._replace(m_p=parameters.m_p + mass), PRESSED_B, True)


@pytest.fixture(scope="module")
def shared() -> Linearisation:
    return Linearisation(AIR, [at_rest(0.0)])


def rendering(shared: Linearisation, stiffness: float, mass: float) -> Hand:
    """What a hand feels that holds the platform, with `mass` (kg) on it of which the controller knows."""
    point = at_rest(mass)
    of_it = shared.with_experiment(loaded(mass))
    robot = robot_with(
        FreePlant(linear_plant(point.parameters, point.x, point.theta_m)), EMPTY_HAND, of_it.drives, of_it.stepping
    )
    kp = stiffness / DAMPING
    law = linear_law(
        of_it.settings(True)._replace(position=Gains(kp), force=Gains(1.0 / stiffness)), of_it.estimation(point)
    )
    return hand_of(robot, law, dict(zip(LOOPS, (KP / kp, KP / kp, 1.0, 1.0), strict=True)))


def loaded(mass: float):
    heavy = with_plant(AIR, m_p=AIR.plant.m_p + mass)
    return with_model(heavy, m_p=AIR.controller.model.m_p + mass)


def edge(shared: Linearisation) -> float:
    """Largest virtual stiffness (N/m) that is rendered passively along z with `DAMPING`."""

    def least(stiffness: float) -> float:
        hand = rendering(shared, stiffness, 0.0)
        omega = 2.0 * np.pi * hertz(hand.period, WIDTH_FREQUENCIES)
        return float(power_share(hand.admittance(omega)[:, 2:, 2:]).min()) if hand.growth < DRIFT_RATE else np.nan

    return largest_passive(least, np.array([least(stiffness) for stiffness in VIRTUAL_STIFFNESS]))


def simulated(stiffness: float) -> float:
    """Growth (1/s) along z of what a nudge leaves in the co-simulation with `MASS` in the hand."""
    experiment, tick = loaded(MASS), AIR.cosim.tick
    c = experiment.controller
    gains = {
        "position": c.position.model_copy(update={"kp": stiffness / DAMPING}),
        "force": c.force.model_copy(update={"kp": 1.0 / stiffness, "ki": 0.0}),
    }
    experiment = holding_experiment(replace(experiment, controller=c.model_copy(update=gains)), at_rest(MASS))
    nudged = [p + NUDGE for p in at_rest(MASS).p_B]

    def made() -> Assembly:
        assembly = assemble(replace(experiment, duration_ticks=round(LONG / tick)))
        assembly.system.component("controller").memory["position"]["kp"][0, :2] = KP  # type: ignore[attr-defined]
        return assembly

    ways = [partial(set_hold_point, p_B=nudged)]
    (path,) = simulate_variants(made, round(NUDGE_TIME / tick), round(LONG / tick), ["plant.p_B"], ways)
    z, width = path["plant.p_B"][:, 2], round(1.0 / tick)
    begin = round((NUDGE_TIME + 0.3 * (LONG - NUDGE_TIME)) / tick)
    return float(np.log(np.std(z[-width:]) / np.std(z[begin : begin + width])) / ((len(z) - width - begin) * tick))


def test_just_inside_the_edge_a_mass_comes_to_rest_and_just_outside_it_swings(shared: Linearisation):
    stiffness = edge(shared)
    assert 0.3 * 2137.0 < stiffness < 2137.0
    inside, outside = (simulated(share * stiffness) for share in (INSIDE, OUTSIDE))
    assert inside < 0.0 < outside
    predicted = [rendering(shared, share * stiffness, MASS).growth for share in (INSIDE, OUTSIDE)]
    # encoders, drives and coupling are the same; the nudge is not infinitely small
    np.testing.assert_allclose([inside, outside], predicted, atol=0.02)


def test_what_is_passive_is_stable_with_every_mass_and_what_is_not_with_some_not(shared: Linearisation):
    stiffness = edge(shared)
    masses = (0.1, 0.3, 0.5, 0.7, 1.0)
    assert all(rendering(shared, 0.9 * stiffness, mass).growth < DRIFT_RATE for mass in masses)
    assert any(rendering(shared, OUTSIDE * stiffness, mass).growth > DRIFT_RATE for mass in masses)
