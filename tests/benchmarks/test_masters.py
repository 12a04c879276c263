"""What other masters are raced with is one system, and a race of different results is none."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.macro_step import START
from benchmarks.masters import FMU, NAMES, TICK, WIRED, refuse_different_results, ring
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system

JACOBI = MasterChoice(scheme="jacobi", tick=TICK)


def test_archive_and_wires_are_the_same_ring_and_turn_as_written_by_hand(tmp_path: Path):
    theta, omega = np.array(START), np.zeros(3)
    rows = [theta]
    for _ in range(WIRED.ticks):
        # each drive turns for a step at the speed that it is given: the angle of the one before
        omega = np.roll(theta, 1)
        theta = theta + TICK * omega
        rows.append(theta)
    found = WIRED.in_twin(JACOBI)
    np.testing.assert_allclose(found, np.array(rows), rtol=0.0, atol=1e-15)
    with open_system(read_package(ring(tmp_path / "ring.ssp", FMU)), JACOBI) as (_, made):
        row = Simulation(made.system, WIRED.ticks, WIRED.ticks + 1).run()[-1]
        outputs = np.concatenate([row[made.columns[name]] for name in NAMES])
    assert set(found[-1]) <= set(outputs)


def test_masters_that_end_differently_are_not_raced():
    refuse_different_results("another", np.array(START), np.array(START) + 1e-13)
    with pytest.raises(RuntimeError, match="another and twin cosim end differently"):
        refuse_different_results("another", np.array(START), np.array(START) + 2e-12)
