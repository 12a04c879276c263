import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from tests.conftest import examples
from tests.laws.runs import shipped
from twin.studies.analyse.linear.loops import (
    LOOPS,
    REFERENCE_SIGNALS,
    SPEED_COMMANDS,
    closed_loops,
    closed_poles,
    spectral_radius,
)
from twin.studies.analyse.linear.margins import (
    DiskMargin,
    Margins,
    disk_margin,
    frequencies,
    gain_limit,
    largest_mu,
    loop_response,
    margins,
    poles,
    sensitivity,
    smallest_disk,
    worst_sensitivity,
)
from twin.studies.analyse.linearised import Linearisation, LinearPoint
from twin.studies.analyse.operating_point import operating_points

PERIOD = 2e-3
CLOSED = dict.fromkeys(LOOPS, 1.0)


def integrators(k: float) -> control.StateSpace:
    """Four loops L = k / (z - 1) that do not see each other."""
    B = np.hstack([np.eye(4), np.zeros((4, 4))])
    return control.ss(
        np.eye(4), B, -k * np.eye(4), np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCE_SIGNALS], outputs=list(LOOPS)
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
    loops = control.ss(A, B, C, np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCE_SIGNALS], outputs=list(LOOPS))
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


def disk_integrators(K: np.ndarray) -> control.StateSpace:
    """L = K / (z - 1), four loops that see each other where K is not diagonal."""
    B = np.hstack([np.eye(4), np.zeros((4, 4))])
    D = np.zeros((4, 8))
    return control.ss(np.eye(4), B, -K, D, PERIOD, inputs=[*LOOPS, *REFERENCE_SIGNALS], outputs=list(LOOPS))


@pytest.fixture(scope="module")
def pressing() -> LinearPoint:
    points, _ = operating_points(shipped())
    shared = Linearisation(shipped(), points)
    return shared.linear_point(next(point for point in points if point.in_contact))


def with_factors(loops: control.StateSpace, gains: dict[str, float], breaks: tuple[str, ...], f: np.ndarray) -> float:
    """Largest magnitude of a pole when the signal at each break is multiplied by a factor (k,)."""
    closed = closed_loops(loops, gains)
    i, o = ([labels.index(name) for name in breaks] for labels in (closed.input_labels, closed.output_labels))
    more = np.diag(f - 1.0)
    back = np.linalg.solve(np.eye(len(f)) - more @ closed.D[np.ix_(o, i)], more @ closed.C[o])
    return float(np.abs(np.linalg.eigvals(closed.A + closed.B[:, i] @ back)).max())


def factors(delta: np.ndarray) -> np.ndarray:
    return (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)


def worst_delta(S: np.ndarray) -> np.ndarray:
    """The smallest numbers (k,) of one size that make 1 - Delta (S - 1/2) singular, k <= 3."""
    M = S - 0.5 * np.eye(len(S))

    def turned(angles: np.ndarray) -> np.ndarray:
        return np.exp(1j * np.concatenate([[0.0], angles]))

    def smallness(angles: np.ndarray) -> float:
        return -float(np.abs(np.linalg.eigvals(turned(angles)[:, None] * M)).max())

    starts = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, (20, len(M) - 1))
    best = min((minimize(smallness, start) for start in starts), key=lambda found: found.fun)
    eigenvalues = np.linalg.eigvals(turned(best.x)[:, None] * M)
    return turned(best.x) / eigenvalues[np.argmax(np.abs(eigenvalues))]


@examples(20)
@given(st.floats(0.05, 1.8), st.sampled_from([-1.0, 0.0, 0.5, 1.0]))
def test_of_one_loop_it_is_the_closed_form(k, skew):
    loops = disk_integrators(k * np.eye(4))
    omega = frequencies(PERIOD)
    L = loop_response(loops, CLOSED, "force", omega)
    _, alpha = smallest_disk(sensitivity(loops, CLOSED, ["force"], omega), skew)
    # two ways to the same frequency response
    assert alpha == pytest.approx(1.0 / np.abs(1.0 / (1.0 + L) + 0.5 * (skew - 1.0)).max(), rel=1e-9)


@examples(20)
@given(st.floats(0.05, 1.8))
def test_of_a_known_loop_it_is_as_calculated(k):
    found = disk_margin(disk_integrators(k * np.eye(4)), CLOSED, ["force"])
    # (S - T)/2 = (z - 1 - k) / (z - 1 + k) / 2 is largest at z = -1, where frequencies end at 0.999 of it
    assert found.alpha == pytest.approx(2.0 * (2.0 - k) / (2.0 + k), rel=1e-4)
    # and the gain up to which it is stable is 2/k
    assert found.gain == pytest.approx(2.0 / k, rel=2e-3)


def test_loops_that_do_not_see_each_other_have_the_margin_of_the_worst():
    loops = disk_integrators(np.diag([0.1, 0.2, 0.3, 0.4]))
    together = disk_margin(loops, CLOSED, LOOPS)
    assert together.alpha == pytest.approx(disk_margin(loops, CLOSED, ["force"]).alpha, rel=1e-6)


@examples(5)
@given(st.integers(0, 1000))
def test_factors_at_the_margin_make_three_coupled_loops_swing_for_ever_and_smaller_ones_do_not(seed):
    rng = np.random.default_rng(seed)
    K = 0.3 * np.eye(4) + rng.uniform(-0.1, 0.1, (4, 4))
    loops, breaks = disk_integrators(K), LOOPS[:3]
    margin = disk_margin(loops, CLOSED, breaks)
    delta = worst_delta(sensitivity(loops, CLOSED, breaks, np.array([margin.frequency]))[0])
    # 2048th powers for the largest singular value
    assert np.abs(delta) == pytest.approx(margin.alpha, rel=2e-3)
    assert with_factors(loops, CLOSED, breaks, factors(delta)) == pytest.approx(1.0, abs=1e-4)
    for size in rng.uniform(0.0, 0.98 * margin.alpha, (20, 3)):
        inside = size * np.exp(2j * np.pi * rng.uniform(size=3))
        assert with_factors(loops, CLOSED, breaks, factors(inside)) < 1.0


def test_what_is_added_at_the_motors_acts_as_what_the_law_commands(pressing: LinearPoint):
    loops = pressing.loops
    laws, motors = ([loops.input_labels.index(name) for name in names] for names in (LOOPS[:3], SPEED_COMMANDS))
    commanded = loops.D[[loops.output_labels.index(name) for name in SPEED_COMMANDS]][:, laws]
    assert np.abs(commanded).min(axis=0).max() > 1.0
    # one product of matrices
    np.testing.assert_allclose(loops.B[:, laws], loops.B[:, motors] @ commanded, rtol=1e-9, atol=1e-12)


def test_the_robot_s_motors_may_be_off_by_all_that_is_inside_and_not_by_more(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    margin = disk_margin(loops, gains, SPEED_COMMANDS)
    delta = worst_delta(sensitivity(loops, gains, SPEED_COMMANDS, np.array([margin.frequency]))[0])
    assert np.abs(delta) == pytest.approx(margin.alpha, rel=2e-3)
    # a pole z moves by 1e-5 for a thousandth of the margin
    assert with_factors(loops, gains, SPEED_COMMANDS, factors(0.99 * delta)) < 1.0
    assert with_factors(loops, gains, SPEED_COMMANDS, factors(1.01 * delta)) > 1.0


def test_gains_of_laws_and_motors_may_be_off_together_by_what_is_told(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    breaks = (*gains, *SPEED_COMMANDS)
    margin = disk_margin(loops, gains, breaks)
    assert margin.gain is not None
    for f in np.random.default_rng(5).choice([margin.gain, 1.0 / margin.gain], (30, len(breaks))):
        assert with_factors(loops, gains, breaks, f) < 1.0


def test_the_more_is_off_at_once_the_smaller_the_margin(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    both = disk_margin(loops, gains, (*gains, *SPEED_COMMANDS)).alpha
    for some in (tuple(gains), SPEED_COMMANDS):
        together = disk_margin(loops, gains, some).alpha
        assert both < together
        for name in some:
            assert together <= disk_margin(loops, gains, [name]).alpha * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("alpha", "gain", "degrees"), [(1.0, 3.0, 53.130), (2.0, None, 90.0), (0.0, 1.0, 0.0), (2.5, None, 102.68)]
)
def test_a_disk_says_gain_and_phase(alpha, gain, degrees):
    disk = DiskMargin(alpha, 1.0)
    assert disk.gain == gain
    assert np.degrees(disk.phase) == pytest.approx(degrees, abs=1e-3)


def test_a_resonance_that_is_narrower_than_the_grid_of_frequencies_passes_unseen():
    """What the disk says holds at the frequencies that are looked at."""
    omega = frequencies(PERIOD)
    between = float(np.sqrt(omega[1000] * omega[1001]))
    # the first loop reaches -1/2 there: a mode that loses 1e-6 of its swing in a period. The others have their worst
    # elsewhere, and around that the grid is made finer
    turn, kept = between * PERIOD, 1.0 - 1e-6
    mode = kept * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    K = np.diag([0.01, 0.5, 0.5, 0.5])
    A = np.block([[np.eye(4), np.zeros((4, 2))], [np.zeros((2, 4)), mode]])
    B, C = np.zeros((6, 8)), np.zeros((4, 6))
    B[:4, :4], B[4, 0], C[:, :4], C[0, 4] = np.eye(4), 1.0, -K, 2.0 * (1.0 - kept) * 0.5
    loops = control.ss(A, B, C, np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCE_SIGNALS], outputs=list(LOOPS))
    seen = disk_margin(loops, CLOSED, LOOPS).alpha
    _, there = smallest_disk(sensitivity(loops, CLOSED, LOOPS, np.array([between])))
    # S = 2 of one loop: 1/(2 - 1/2)
    assert there == pytest.approx(2.0 / 3.0, rel=0.01)
    # L = -1/4 at half the rate: S = 4/3
    assert seen == pytest.approx(1.2, rel=0.01)


MATRICES = st.tuples(st.integers(2, 7), st.integers(0, 10_000))


def drawn(rows: int, seed: int, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(*shape, rows, rows)) + 1j * rng.normal(size=(*shape, rows, rows))


def bound(M: np.ndarray) -> float:
    return largest_mu(M[None])[1]


def reached(M: np.ndarray) -> float:
    """The largest spectral radius of Delta M over diagonal Delta of size 1 that were tried: mu is at least that."""

    def radius(angles: np.ndarray) -> float:
        return -float(np.abs(np.linalg.eigvals(np.exp(1j * np.concatenate([[0.0], angles]))[:, None] * M)).max())

    starts = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (12, len(M) - 1))
    return -min(minimize(radius, start, method="BFGS").fun for start in starts)


@examples(10)
@given(st.tuples(st.integers(2, 3), st.integers(0, 10_000)))
def test_up_to_three_rows_the_bound_is_reached(case):
    M = drawn(*case)
    # 2048th powers for the largest singular value
    assert reached(M) == pytest.approx(bound(M), rel=2e-3)


@examples(5)
@given(st.integers(0, 10_000))
def test_beyond_it_is_no_less_than_what_is_reached(seed):
    M = drawn(6, seed)
    assert reached(M) <= bound(M) * (1.0 + 1e-9)


@examples(20)
@given(MATRICES)
def test_of_a_matrix_of_rank_one_it_is_the_sum_of_the_diagonal_s_sizes(case):
    u, v = drawn(*case)[:2]
    # det(1 - Delta u v^H) = 1 - sum of delta_i u_i conj(v_i)
    assert bound(np.outer(u, v.conj())) == pytest.approx(np.abs(u * v).sum(), rel=1e-6)


@examples(20)
@given(MATRICES)
def test_of_a_diagonal_or_triangular_matrix_it_is_the_largest_diagonal_element(case):
    M = drawn(*case)
    expected = np.abs(np.diag(M)).max()
    assert bound(np.diag(np.diag(M))) == pytest.approx(expected, rel=1e-9)
    # the best scaling is infinite: what is left of the corner
    assert bound(np.triu(M)) == pytest.approx(expected, rel=2e-3)


@examples(20)
@given(MATRICES)
def test_units_of_the_signals_do_not_matter(case):
    M = drawn(*case)
    D = np.exp(np.random.default_rng(case[1]).uniform(-3.0, 3.0, len(M)))
    assert bound(D[:, None] * M / D) == pytest.approx(bound(M), rel=1e-3)


def test_the_largest_of_many_is_found_without_looking_at_each():
    many = drawn(5, 3, 40)
    which, found = largest_mu(many)
    each = [bound(M) for M in many]
    assert which == int(np.argmax(each)) and found == pytest.approx(max(each), rel=1e-3)
