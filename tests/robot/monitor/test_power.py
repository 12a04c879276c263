"""What the monitor's `power` does to drives."""

from dataclasses import replace

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace, run_in_memory

RUNAWAY = 'fault=[{kind="drive_runaway", onset_s=2.0, magnitude_rad_per_s=2.0}]'


def run(*settings: str) -> Trace:
    """Pressing with drives whose current `enable` switches, one of which runs away."""
    experiment = load_experiment(
        EXPERIMENTS / "pressing.toml", [RUNAWAY, "duration_s=12", *settings], "torque_motor_fmi3"
    )
    return run_in_memory(replace(experiment, duration_ticks=3000))


def test_a_drive_that_can_be_switched_loses_its_current_with_the_power():
    rows = run()
    off = int(np.argmin(rows.held("monitor.power")))
    assert 2000 < off < 3000
    tau_motor = np.array([rows[f"drive/{i}.tau_motor"] for i in (1, 2, 3)])
    assert np.abs(tau_motor[:, off - 10 : off]).max() > 0.01
    # the current dies within some ms; what is left of a torque is the cogging of the machine
    assert np.abs(tau_motor[:, off + 50 :]).max() < 1e-3


def test_an_enable_that_the_experiment_fixes_is_left_alone():
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", ["drive.parameters.enable=1"], "torque_motor_fmi3")
    with assemble(experiment) as assembly:
        assert "enable" not in [port.name for port in assembly.system.component("drive_1").inputs]


@pytest.mark.parametrize(("drive", "monitor"), [("velocity_servo", "true"), ("torque_motor_fmi3", "false")])
def test_nothing_is_switched_without_the_role_or_without_a_monitor(drive: str, monitor: str):
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", [f"monitor.enabled={monitor}"], drive)
    with assemble(experiment) as assembly:
        assert "enable" not in [port.name for port in assembly.system.component("drive_1").inputs]
