"""The linear analysis against the co-simulation with the real drive FMU."""

import numpy as np
import pytest

from tests.studies.analyse.simulated import (
    AIR,
    NUDGE,
    PRESSING,
    RESTED,
    difference,
    fig4,
    pressing_with_force_loop,
    simulated_limit,
)
from twin.studies.analyse.linear.loops import closed_loops
from twin.studies.analyse.linear.margins import gain_limit
from twin.studies.analyse.linearised import Linearisation, LinearPoint
from twin.studies.analyse.operating_point import operating_points
from twin.studies.analyse.stability import FORCE_LOOPS, POSITION_LOOPS

CLOSE = 0.02
"""Of the largest deflection: what a linear prediction of a small step may miss."""
LIMIT = 0.1
"""What the prediction of a gain limit may miss."""
POSITION_GAIN = {"controller.position.kp_per_s": 1.5}
FORCE_GAINS = {"controller.force.kp_mm_per_N": 2.0, "controller.force.ki_mm_per_N_s": 0.5}
FORCE_ON = ("controller.force.trigger_time_s=0", "reference.t_s=[0]", "reference.p_mm=[[0,20,-105]]")


def linear(overrides, in_contact: bool) -> LinearPoint:
    experiment = fig4(overrides)
    points, problems = operating_points(experiment)
    assert not problems
    shared = Linearisation(experiment, points)
    return shared.linear_point(
        next(point for point in points if point.in_contact == in_contact and point.force_on == in_contact)
    )


def step_response(point: LinearPoint, reference: str, size: float, output: str, count: int) -> np.ndarray:
    system = closed_loops(point.loops, point.gains)
    i, o = system.input_labels.index(reference), system.output_labels.index(output)
    x, response = np.zeros(system.nstates), []
    for _ in range(count):
        response.append(system.C[o] @ x + system.D[o, i] * size)
        x = system.A @ x + system.B[:, i] * size
    return np.array(response)


@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
@pytest.mark.parametrize("delay", [(), ("controller.delay_ticks=1", "controller.bus_delay_ticks=2")])
def test_a_small_step_in_air_goes_as_predicted(scheme, delay):
    base = [*AIR, f"cosim.scheme={scheme}", *delay, "controller.position.kp_per_s=10"]
    start, nudged = "[0,20,-100]", f"[0,20,{-100 + 1e3 * NUDGE!r}]"
    stepped = [f"reference.p_mm=[{start},{start},{nudged}]"]
    still, moved = difference([*base, f"reference.p_mm=[{start},{start},{start}]"], stepped, RESTED + 2.0)
    found = (moved["plant.p_B"] - still["plant.p_B"])[round(1e3 * RESTED) + 2 :: 2, 2]
    predicted = step_response(linear(base, False), "p_ref_B_z", NUDGE, "p_B_z", len(found))
    np.testing.assert_allclose(found, predicted, atol=CLOSE * NUDGE)


def test_a_small_step_of_the_force_reference_goes_as_predicted():
    base, size = [*PRESSING, *FORCE_ON, "controller.mode=force_position", "controller.force.ki_mm_per_N_s=20"], 0.02
    still, moved = difference(base, [f"controller.force.reference_N={5.0 + size}"], 2.0)
    for output, sign in (("F_z", 1.0), ("F_ee_B_z", -1.0)):
        found = moved["controller.F_z"] - still["controller.F_z"]
        if sign < 0.0:
            found = (moved["plant.F_ee_B"] - still["plant.F_ee_B"])[::2, 2]
        predicted = step_response(linear(base, True), "F_z_ref", size, output, len(found))
        np.testing.assert_allclose(found, predicted, atol=CLOSE * size)


def test_the_gain_limit_of_the_position_law_in_air_is_the_simulated_one():
    point = linear(AIR, False)
    predicted = gain_limit(point.loops, point.gains, POSITION_LOOPS)
    assert predicted is not None
    assert simulated_limit(AIR, POSITION_GAIN, predicted) == pytest.approx(predicted, rel=LIMIT)


def test_the_gain_limits_while_pressing_are_the_simulated_ones():
    pressing = pressing_with_force_loop()
    point = linear(pressing, True)
    for names, gains in ((FORCE_LOOPS, FORCE_GAINS), (POSITION_LOOPS, POSITION_GAIN)):
        predicted = gain_limit(point.loops, point.gains, names)
        assert predicted is not None
        assert simulated_limit(pressing, gains, predicted) == pytest.approx(predicted, rel=LIMIT)
