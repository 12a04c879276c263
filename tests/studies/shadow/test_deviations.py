"""The printed deviations cover healthy robots, and those of an identified robot are smaller."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.studies.identify.calibrations import identification
from tests.studies.shadow.robots import EXPERIMENTS, STATE, shipped_fleet, true_state
from twin.kernel.cosim.delay import values_by_port
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.identify.text import model_fragment
from twin.studies.replay.model import model_of
from twin.studies.replay.samples import samples_of
from twin.studies.shadow.deviations import DEAD_ZONE_KEY, SPRING_KEY, HealthyDeviation, is_identified
from twin.studies.shadow.filter_steps import filter_outputs, shadow_of
from twin.studies.shadow.fleet import ZERO_RANGE
from twin.studies.shadow.following import twin_of
from twin.studies.shadow.layout import FORCE, OUTPUTS, STATES

TASKS = ("fig4_force_position", "pressing", "tapping")


@cache
def outside(name: str, corner: int) -> NDArray[np.float64]:
    """Shares of the samples of a robot at a corner whose errors exceed 1.96 printed deviations, and 1.96 of the
    filter's own: of position, velocity, motor angles, their speeds, force."""
    fleet = shipped_fleet(EXPERIMENTS / f"{name}.toml")
    random = np.random.default_rng([fleet.seed, corner])
    zeros = [
        f"plant.{side}_zero_deg={random.uniform(-ZERO_RANGE, ZERO_RANGE, 3).tolist()}" for side in ("motor", "joint")
    ]
    own = (*fleet.settings, *fleet.corners[corner], *zeros, f"seed={corner}")
    robot, twin = load_experiment(fleet.experiment, own), fleet.twin()
    run = run_in_memory(robot, robot.controller_ticks)
    samples, later = samples_of(run), run.time("encoder") > 0.5
    own_deviation = filter_outputs(shadow_of(twin), samples)["deviation"]
    y = values_by_port(OUTPUTS, twin_of(twin, model_of(twin), "robot").feed(samples)["shadow"])
    error = np.abs(np.column_stack([y[state] for state in STATE]) - true_state(run))[later]
    beyond = [error > 1.96 * deviation[later] for deviation in (y["deviation"], own_deviation)]
    return np.array([one.reshape(len(one), 5, 3).mean(axis=(0, 2)) for one in beyond])


@pytest.mark.slow
def test_at_the_corners_of_the_fleet_at_most_a_tenth_of_the_samples_lies_outside_the_printed_deviations():
    printed, own = np.mean([outside(name, corner) for name in TASKS for corner in range(0, 64, 9)], axis=0)
    assert np.all(printed <= 0.1)
    # the filter's own are those of a robot that is as believed
    assert own[[0, 2, 4]].min() > 0.3


@pytest.mark.slow
def test_the_tables_that_twin_identify_writes_make_a_robot_identified_once_plant_is_uncommented(tmp_path: Path):
    fragment = model_fragment(identification(), "run.mcap")
    belief, _, plant = fragment.partition("# for the twin of a real robot")
    assert "[controller.model]" in belief and "[plant]" not in belief
    commented = [line.removeprefix("# ") for line in plant.splitlines()[1:]]
    for name, text in (("belief", fragment), ("plant", "\n".join([belief, *commented]))):
        (tmp_path / f"{name}.toml").write_text(f'extends = "{EXPERIMENTS / "calibration.toml"}"\n{text}\n')
        experiment = load_experiment(tmp_path / f"{name}.toml")
        found = [is_identified(experiment, key) for key in (SPRING_KEY, DEAD_ZONE_KEY)]
        assert found == [name == "plant"] * 2
    assert experiment.plant.k_s == experiment.controller.model.k_s == pytest.approx(1.07, rel=2e-3)
    assert experiment.plant.backlash == experiment.controller.dead_zone


def test_what_was_identified_widens_no_force(tmp_path: Path):
    source = tmp_path / "identified.toml"
    own = 'k_s_Nm_per_rad = { value = 1.0, source = "identified from a.csv" }\n'
    own += 'backlash_deg = { value = 0.1, source = "identified from a.csv" }\n'
    source.write_text(f'extends = "{EXPERIMENTS / "pressing.toml"}"\n[plant]\n{own}')
    nothing = np.zeros((1, STATES)), np.zeros(1), np.zeros(1), 15.0 * np.eye(3)[None], np.full((1, 3), 0.2)
    known, unknown = (
        HealthyDeviation(load_experiment(path)).widen(*nothing)[0, FORCE]
        for path in (source, EXPERIMENTS / "pressing.toml")
    )
    assert 0.0 < known < unknown - 0.01


def test_noise_that_the_twin_does_not_know_of_widens_by_its_nis():
    healthy = HealthyDeviation(load_experiment(EXPERIMENTS / "pressing.toml"))
    n, ones = 5000, np.ones((5000, STATES))
    wide = healthy.widen(
        ones, np.full(n, 24.0), np.full(n, 6.0), np.tile(15.0 * np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    )
    # of speeds, which have no bias
    assert wide[-1, 3:6] == pytest.approx([2.0] * 3)
