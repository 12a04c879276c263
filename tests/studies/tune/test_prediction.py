import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.studies.tune.corners import fig4_corners, predicted
from twin.kernel.errors import InputRefused
from twin.studies.analyse.linear.loops import closed_loops, closed_poles
from twin.studies.analyse.linear.margins import margins
from twin.studies.analyse.linearised import Linearisation
from twin.studies.tune.prediction import (
    Goals,
    LawGains,
    close_loops,
    confirms_sensitivity,
    predict,
    sensitivities,
    step_response,
    stiffness_range,
    with_gains,
)


@pytest.mark.parametrize(
    ("goals", "sentence"),
    [
        ({"sensitivity": 1.0}, "--margin 1: no loop has"),
        ({"sensitivity": math.nan}, "--margin nan"),
        ({"overshoot": -0.1}, "--overshoot-percent -10: expected 0 to 100"),
        ({"bandwidth": 0.0}, "--bandwidth-Hz 0: expected more than 0"),
    ],
)
def test_goals_that_nothing_meets_are_refused(goals, sentence):
    with pytest.raises(InputRefused, match=sentence):
        Goals(**goals)


def test_a_bandwidth_beyond_half_the_controllers_rate_is_refused():
    Goals(bandwidth=2.0 * math.pi * 249.0).refuse_period(2e-3)
    with pytest.raises(InputRefused, match="beyond half the controller's rate of 500 Hz"):
        Goals(bandwidth=2.0 * math.pi * 251.0).refuse_period(2e-3)


@pytest.mark.parametrize(
    "text", ["300", "soft:hard", "5000:300", "0:100", "-1:1", "1:inf", "1:nan", "1:2:3", "1:", "1_0:20"]
)
def test_a_stiffness_that_is_no_range_is_refused(text):
    with pytest.raises(InputRefused, match="expected two numbers above 0"):
        stiffness_range(text)


def test_a_range_of_one_stiffness_is_a_range():
    assert stiffness_range("300:300") == (300.0, 300.0)


ONE_OF = st.integers(0, 8)
GAINS = st.builds(LawGains, st.floats(0.5, 12.0), st.floats(1e-5, 5e-3), st.floats(1e-4, 2e-2))
FIG4 = LawGains(1.5, 2e-3, 0.5e-3)
FAST = LawGains(5.0, 1.5e-3, 3.5e-3)


def analysed(i: int, gains: LawGains):
    """The loops of a corner as `twin analyse` makes them, with the compiled laws."""
    corner = fig4_corners()[i]
    return Linearisation(with_gains(corner.experiment, gains), [corner.point]).linear_point(corner.point)


@pytest.fixture(scope="module")
def shared() -> Linearisation:
    return Linearisation(fig4_corners()[0].experiment, [corner.point for corner in fig4_corners()])


@given(ONE_OF, GAINS)
@examples(15)
def test_the_poles_are_those_of_the_compiled_laws(shared, i, gains):
    corner = fig4_corners()[i]
    shared.experiment = with_gains(corner.experiment, gains)
    point = shared.linear_point(corner.point)
    ours, theirs = (np.linalg.eigvals(close_loops(corner, gains)[0]), closed_poles(point.loops, point.gains))
    distances = np.abs(ours[:, None] - theirs[None])
    # eigenvalues that nearly coincide lose half the digits
    assert distances.min(axis=0).max() < 1e-6 and distances.min(axis=1).max() < 1e-6


@pytest.mark.parametrize("i", [1, 5])
def test_sensitivity_and_bandwidth_are_those_that_twin_analyse_tells(i):
    point, corner = analysed(i, FAST), fig4_corners()[i]
    found = {name: margins(point.loops, point.gains, name) for name in point.gains}
    # both search on a grid, 2 % and 1 % apart
    assert predict(corner, FAST).sensitivity == pytest.approx(max(m.sensitivity for m in found.values()), rel=0.02)
    if corner.point.force_on:
        bandwidth = predicted(corner, FAST).bandwidth
        assert bandwidth == pytest.approx(found["force"].bandwidth, rel=0.05)


@pytest.mark.parametrize(("i", "axis", "reference"), [(1, 2, "p_ref_B_z"), (5, 3, "F_z_ref")])
def test_the_step_response_is_that_of_the_linear_loops(i, axis, reference):
    point, corner = analysed(i, FAST), fig4_corners()[i]
    system = closed_loops(point.loops, point.gains)
    _, y, final = step_response(corner, FAST, axis)
    output, sign = ("p_B_z", 1.0) if axis == 2 else ("F_ee_B_z", -1.0)
    x, b = np.zeros(system.nstates), system.B[:, system.input_labels.index(reference)]
    for k in range(300):
        # the rounding of 300 products of matrices
        assert y[k] == pytest.approx(sign * (system.C[system.output_labels.index(output)] @ x), abs=1e-9)
        x = system.A @ x + b
    # but for the droop, which depends a little on the pose, and for the Jacobian, which the estimate takes elsewhere
    assert final == pytest.approx(1.0, abs=0.01)


def test_a_larger_force_reference_presses_harder():
    for corner in fig4_corners():
        if corner.point.force_on:
            _, y, _ = step_response(corner, FIG4, 3)
            assert np.all(np.diff(y[5:200]) > 0.0)


def test_gains_beyond_the_limit_of_free_air_are_unstable():
    # docs/tuning.md: the limit of kp in air is 19.4 1/s
    assert predict(fig4_corners()[1], FIG4._replace(kp=18.5)).stable
    assert not predict(fig4_corners()[1], FIG4._replace(kp=20.5)).stable


@given(ONE_OF, GAINS, st.floats(0.2, 5.0))
@examples(20)
def test_a_factor_on_every_loop_of_a_law_is_one_on_its_gains(i, gains, factor):
    corner = fig4_corners()[i]
    for factors, scaled in (
        ((factor, factor, factor, 1.0), gains._replace(kp=factor * gains.kp)),
        ((1.0, 1.0, 1.0, factor), LawGains(gains.kp, factor * gains.force_kp, factor * gains.force_ki)),
    ):
        for ours, theirs in zip(close_loops(corner, gains, factors), close_loops(corner, scaled), strict=True):
            # rounding
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("i", [1, 3, 5])
def test_eigenvalues_bear_out_the_sensitivity_and_no_smaller_one_that_the_gain_margin_forbids(i):
    corner = fig4_corners()[i]
    M_s = predict(corner, FAST).sensitivity
    assert confirms_sensitivity(corner, FAST, M_s)
    # M_s of 1.001 would leave room for 40 times the gain, which no loop has
    assert not confirms_sensitivity(corner, FAST, 1.001)


def test_where_the_force_law_does_not_act_its_gains_change_nothing():
    air = fig4_corners()[0]
    np.testing.assert_array_equal(sensitivities(air, FIG4), sensitivities(air, FIG4._replace(force_kp=1.0)))
