"""Encoders that answer late: counts of the angles of so many ticks ago, and of the rest before."""

import numpy as np
import pytest

from tests.laws.runs import co_simulated, shipped
from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import with_cosim


@pytest.mark.parametrize("ticks", [1, 3])
def test_counts_are_those_of_so_many_ticks_ago(ticks: int):
    run = co_simulated(
        shipped("step_joint_1", f"plant.encoder_latency_ms={ticks}", "reference.joint_step.start_s=0.1"), 0.4
    )
    counts_per_rad = 16384 / (2.0 * np.pi)
    true = np.floor(run["plant.theta_l"] * counts_per_rad + 0.5)
    sampled = np.arange(0, len(true), 2)
    late = np.maximum(sampled - ticks, 0)
    assert np.array_equal(run["encoder.count_l"], true[late])
    assert not np.array_equal(run["encoder.count_l"], true[sampled])
    motor = np.floor(run.of_drives("theta_m") * (4096 / (2.0 * np.pi)) + 0.5)
    assert np.array_equal(run["encoder.count_m"], motor[late])
    assert np.array_equal(run["latency.theta_l"][ticks:], run["plant.theta_l"][:-ticks])


def test_a_latency_of_half_a_tick_is_refused():
    with pytest.raises(InputRefused, match=r"\[plant\] encoder_latency_ms: 0.0015 s is not a whole number of ticks"):
        shipped("fig4_force_position", "plant.encoder_latency_ms=1.5")


def test_with_another_tick_latency_stays_as_long():
    experiment = shipped("fig4_force_position", "plant.encoder_latency_ms=2")
    assert with_cosim(experiment, tick=5e-4).plant.encoder_latency == 2e-3
    with pytest.raises(
        InputRefused, match=r"latency of the encoders of 0\.001 s is not a whole number of ticks of 0\.002"
    ):
        with_cosim(shipped("fig4_force_position", "plant.encoder_latency_ms=1"), tick=2e-3)
