import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from tests.conftest import examples
from tests.laws.runs import shipped
from twin.studies.analyse.linear.disk import DiskMargin, disk_margin, smallest_disk
from twin.studies.analyse.linear.loops import closed_loops
from twin.studies.analyse.linear.margins import frequencies, loop_response, sensitivity
from twin.studies.analyse.linear.sampled_law import LOOPS, REFERENCES
from twin.studies.analyse.linear.sampled_robot import COMMANDS
from twin.studies.analyse.linear_point import Linearised, LinearPoint
from twin.studies.analyse.operating_point import operating_points

PERIOD = 2e-3
CLOSED = dict.fromkeys(LOOPS, 1.0)


def integrators(K: np.ndarray) -> control.StateSpace:
    """L = K / (z - 1), four loops that see each other where K is not diagonal."""
    B = np.hstack([np.eye(4), np.zeros((4, 4))])
    D = np.zeros((4, 8))
    return control.ss(np.eye(4), B, -K, D, PERIOD, inputs=[*LOOPS, *REFERENCES], outputs=list(LOOPS))


@pytest.fixture(scope="module")
def pressing() -> LinearPoint:
    points, _ = operating_points(shipped())
    shared = Linearised(shipped(), points)
    return shared.at(next(point for point in points if point.in_contact))


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
    loops = integrators(k * np.eye(4))
    omega = frequencies(PERIOD)
    L = loop_response(loops, CLOSED, "force", omega)
    _, alpha = smallest_disk(sensitivity(loops, CLOSED, ["force"], omega), skew)
    # two ways to the same frequency response
    assert alpha == pytest.approx(1.0 / np.abs(1.0 / (1.0 + L) + 0.5 * (skew - 1.0)).max(), rel=1e-9)


@examples(20)
@given(st.floats(0.05, 1.8))
def test_of_a_known_loop_it_is_as_calculated(k):
    found = disk_margin(integrators(k * np.eye(4)), CLOSED, ["force"])
    # (S - T)/2 = (z - 1 - k) / (z - 1 + k) / 2 is largest at z = -1, where frequencies end at 0.999 of it
    assert found.alpha == pytest.approx(2.0 * (2.0 - k) / (2.0 + k), rel=1e-4)
    # and the gain up to which it is stable is 2/k
    assert found.gain == pytest.approx(2.0 / k, rel=2e-3)


def test_loops_that_do_not_see_each_other_have_the_margin_of_the_worst():
    loops = integrators(np.diag([0.1, 0.2, 0.3, 0.4]))
    together = disk_margin(loops, CLOSED, LOOPS)
    assert together.alpha == pytest.approx(disk_margin(loops, CLOSED, ["force"]).alpha, rel=1e-6)


@examples(5)
@given(st.integers(0, 1000))
def test_factors_at_the_margin_make_three_coupled_loops_swing_for_ever_and_smaller_ones_do_not(seed):
    rng = np.random.default_rng(seed)
    K = 0.3 * np.eye(4) + rng.uniform(-0.1, 0.1, (4, 4))
    loops, breaks = integrators(K), LOOPS[:3]
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
    laws, motors = ([loops.input_labels.index(name) for name in names] for names in (LOOPS[:3], COMMANDS))
    commanded = loops.D[[loops.output_labels.index(name) for name in COMMANDS]][:, laws]
    assert np.abs(commanded).min(axis=0).max() > 1.0
    # one product of matrices
    np.testing.assert_allclose(loops.B[:, laws], loops.B[:, motors] @ commanded, rtol=1e-9, atol=1e-12)


def test_the_robot_s_motors_may_be_off_by_all_that_is_inside_and_not_by_more(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    margin = disk_margin(loops, gains, COMMANDS)
    delta = worst_delta(sensitivity(loops, gains, COMMANDS, np.array([margin.frequency]))[0])
    assert np.abs(delta) == pytest.approx(margin.alpha, rel=2e-3)
    # a pole z moves by 1e-5 for a thousandth of the margin
    assert with_factors(loops, gains, COMMANDS, factors(0.99 * delta)) < 1.0
    assert with_factors(loops, gains, COMMANDS, factors(1.01 * delta)) > 1.0


def test_gains_of_laws_and_motors_may_be_off_together_by_what_is_told(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    breaks = (*gains, *COMMANDS)
    margin = disk_margin(loops, gains, breaks)
    assert margin.gain is not None
    for f in np.random.default_rng(5).choice([margin.gain, 1.0 / margin.gain], (30, len(breaks))):
        assert with_factors(loops, gains, breaks, f) < 1.0


def test_the_more_is_off_at_once_the_smaller_the_margin(pressing: LinearPoint):
    loops, gains = pressing.loops, pressing.gains
    both = disk_margin(loops, gains, (*gains, *COMMANDS)).alpha
    for some in (tuple(gains), COMMANDS):
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
    loops = control.ss(A, B, C, np.zeros((4, 8)), PERIOD, inputs=[*LOOPS, *REFERENCES], outputs=list(LOOPS))
    seen = disk_margin(loops, CLOSED, LOOPS).alpha
    _, there = smallest_disk(sensitivity(loops, CLOSED, LOOPS, np.array([between])))
    # S = 2 of one loop: 1/(2 - 1/2)
    assert there == pytest.approx(2.0 / 3.0, rel=0.01)
    # L = -1/4 at half the rate: S = 4/3
    assert seen == pytest.approx(1.2, rel=0.01)
