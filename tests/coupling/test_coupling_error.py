"""The co-simulation with the real drive FMUs against the monolithic reference, same controller, exact encoders."""

import numpy as np
import pytest

from tests.coupling.monolith import monolithic_run
from tests.laws.runs import EXACT_ENCODERS, FORCE, POSITION, co_simulated, shipped

SWITCH = 5.6
# a number of newtons that is never reached stands for 'no threshold'
SCHEDULED = (f"controller.force.trigger_time_s={SWITCH}", "controller.force.trigger_N=1e9")


@pytest.fixture(scope="session")
def position_reference():
    return monolithic_run(shipped(POSITION, *EXACT_ENCODERS), 20.0)


@pytest.fixture(scope="session")
def force_reference():
    return monolithic_run(shipped(FORCE, *EXACT_ENCODERS, *SCHEDULED), 20.0)


def force_error(reference, name, *overrides):
    """Time (s) of the controller's ticks and co-simulated less monolithic F_z (N) at these, shape (n,) each."""
    experiment = shipped(name, *EXACT_ENCODERS, *overrides)
    rows = co_simulated(experiment)
    due = slice(None, None, experiment.controller_ticks)
    return rows.t[due], rows["plant.F_ee_B"][due, 2] - reference["F_ee_B_z"]


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "limit"), [("gauss_seidel", 0.0015), ("jacobi", 0.003)])
def test_without_force_loop_the_coupling_costs_millinewtons_over_the_whole_run(position_reference, scheme, limit):
    _, error = force_error(position_reference, POSITION, f"cosim.scheme={scheme}")
    assert position_reference["F_ee_B_z"].min() < -4.0
    # half as much again as was measured: 0.0010 N and 0.0018 N of 4.5 N
    assert np.abs(error).max() < limit


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
def test_with_force_loop_the_coupling_costs_a_hundredth_of_a_newton(force_reference, scheme):
    t, error = force_error(force_reference, FORCE, *SCHEDULED, f"cosim.scheme={scheme}")
    assert force_reference["F_ee_B_z"].min() < -4.9
    # half as much again as was measured: 0.0090 N in the jump after the switch, 0.0040 N from 0.5 s later on
    assert np.abs(error).max() < 0.014
    assert np.abs(error[t >= SWITCH + 0.5]).max() < 0.006


def test_with_force_loop_halving_the_step_halves_the_error(force_reference):
    _, coarse = force_error(force_reference, FORCE, *SCHEDULED)
    _, fine = force_error(force_reference, FORCE, *SCHEDULED, "cosim.tick_ms=0.5")
    # order one; the nearby friction and backlash events shift by a step and blur it
    assert np.abs(coarse).max() / np.abs(fine).max() == pytest.approx(2.0, abs=0.2)
