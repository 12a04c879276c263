import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from twin.studies.analyse.linear.loops import closed_loops, closed_poles, spectral_radius
from twin.studies.analyse.linear.margins import (
    Margins,
    gain_limit,
    loop_response,
    margins,
    poles,
    worst_sensitivity,
)
from twin.studies.analyse.linear.sampled_law import LOOPS, REFERENCES

PERIOD = 2e-3
CLOSED = dict.fromkeys(LOOPS, 1.0)


def integrators(k: float) -> control.StateSpace:
    """Four loops L = k / (z - 1) that do not see each other."""
    B = np.hstack([np.eye(4), np.zeros((4, 4))])
    return control.ss(
        np.eye(4), B, -k * np.eye(4), np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCES], outputs=list(LOOPS)
    )


@examples(15)
@given(st.floats(0.01, 1.5))
def test_margins_of_an_integrator_are_those_of_its_formula(k):
    found = margins(integrators(k), CLOSED, "force")
    # |k / (z - 1)| = 1 at 2 sin(w T / 2) = k, where the phase is -90 deg - w T / 2; at z = -1 the gain is k / 2
    crossover = 2.0 * np.arcsin(k / 2.0) / PERIOD
    # splines through 1500 points; the phase crossing lies at half the sampling rate, just beyond the last of them
    assert found.crossover == pytest.approx(crossover, rel=1e-3)
    assert found.phase == pytest.approx(np.pi / 2.0 - 0.5 * crossover * PERIOD, rel=1e-3)
    # M_s = |1 / (1 + L)| at z = -1 is 2 / (2 - k)
    assert found.sensitivity == pytest.approx(max(2.0 / (2.0 - k), 1.0), rel=0.01)


@given(st.floats(0.01, 1.9))
def test_the_gain_limit_is_where_the_pole_leaves_the_circle(k):
    # pole 1 - k f; bisected to 1e-4
    limit = gain_limit(integrators(k), CLOSED, ("force",))
    assert limit is not None and limit == pytest.approx(2.0 / k, rel=2e-4)
    assert spectral_radius(integrators(k), {"force": limit}) <= 1.0


def test_a_limit_below_one_says_how_far_gains_must_fall():
    assert gain_limit(integrators(4.0), CLOSED, LOOPS) == pytest.approx(0.5, rel=2e-4)


def test_gains_that_never_help_have_the_limit_zero():
    assert gain_limit(integrators(-0.1), CLOSED, LOOPS) == 0.0


def test_a_gain_margin_that_eigenvalues_contradict_is_not_told():
    # its phase crosses -180 degrees only at half the sampling rate, where the frequency response ends
    found = margins(integrators(0.5), CLOSED, "force")
    assert found.gain is None and "disagree" in found.remark


def test_the_phase_margin_loop_with_a_delay_has_the_gain_margin_of_its_formula():
    # L = k / (z (z - 1)): the phase is -180 degrees at w T = pi / 3, the gain there k
    k = 0.25
    A = np.kron(np.eye(4), [[1.0, 1.0], [0.0, 0.0]])
    B = np.hstack([np.kron(np.eye(4), [[0.0], [1.0]]), np.zeros((8, 4))])
    C = np.kron(np.eye(4), [[-k, 0.0]])
    loops = control.ss(A, B, C, np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCES], outputs=list(LOOPS))
    found = margins(loops, CLOSED, "position_z")
    assert isinstance(found, Margins)
    # splines through 1500 points
    assert found.gain == pytest.approx(1.0 / k, rel=1e-3)
    assert found.gain_frequency == pytest.approx(np.pi / 3.0 / PERIOD, rel=1e-3)
    assert gain_limit(loops, CLOSED, ("position_z",)) == pytest.approx(1.0 / k, rel=2e-4)
    L = loop_response(loops, CLOSED, "position_z", np.array([np.pi / 3.0 / PERIOD]))
    # one linear solve
    assert L[0] == pytest.approx(-k, rel=1e-9)


def test_loops_that_do_not_see_each_other_are_no_worse_together():
    loops = integrators(0.5)
    alone = max(margins(loops, CLOSED, name).sensitivity for name in LOOPS)
    # the same numbers by another way
    assert worst_sensitivity(loops, CLOSED) == pytest.approx(alone, rel=1e-9)


@given(st.floats(0.05, 1.5), st.floats(0.05, 1.5))
def test_closing_loops_moves_the_poles_to_where_they_are_told(k, factor):
    loops = integrators(k)
    gains = {"position_x": factor, "force": 1.0}
    closed = closed_loops(loops, gains)
    # two eigenvalue computations of the same matrix
    np.testing.assert_allclose(np.sort(closed.poles().real), np.sort(closed_poles(loops, gains).real), atol=1e-12)
    np.testing.assert_allclose(np.sort(closed.poles().real), np.sort([1.0, 1.0, 1.0 - k * factor, 1.0 - k]), atol=1e-12)


def test_poles_are_told_as_frequency_and_damping():
    omega, zeta = 80.0, 0.05
    s = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    (found,) = poles(np.array([np.exp(s * PERIOD), np.exp(s.conjugate() * PERIOD), 0.0]), PERIOD)
    # exp and log
    assert found == pytest.approx((omega, zeta), rel=1e-9)


def test_a_pole_at_one_neither_grows_nor_decays():
    (found,) = poles(np.array([1.0 + 0.0j]), PERIOD)
    assert found.zeta == 0.0
