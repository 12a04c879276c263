"""One step response and one tracking error per drive, against stored baselines.

To accept new numbers on purpose: python -m tests.regression.test_drives, and a line in CHANGELOG under Numbers moved.
"""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest

from twin.execution import execute
from twin.experiment.experiment import load_experiment
from twin.metrics.response import overshoot, rise_time, settling_time, within
from twin.metrics.tracking import rms
from twin.paper.fig4_runs import SWEEP, Fig4Run
from twin.recording.reader import read
from twin.recording.recording import Recording

ROOT = Path(__file__).parents[2]
BASELINES = Path(__file__).parent / "baselines"
DRIVES = tuple(sorted(path.parent.name for path in ROOT.glob("fmus/*/*.fmu")))

TOLERANCE = 0.02
"""Relative: libm differs between machines by rounding only, which the encoders can turn into single counts: 1.5 mrad of
3.6 degrees of spring wind-up; over a whole response that averages to below 2 %."""


def recorded(experiment: str, drive: str, folder: Path) -> Recording:
    folder.mkdir()
    return read(execute(load_experiment(ROOT / "experiments" / experiment, drive=drive), folder).recording)


def step_response(recording: Recording) -> dict[str, float]:
    """Of z to the step from -85 to -90 mm at 0.5 s, on the true position."""
    t = recording.time("plant")
    after = t >= 0.5
    travel = -(recording["plant.p_B"][after, 2] + 0.085)
    t = t[after] - 0.5
    return {
        "rise_time_s": rise_time(t, travel, 0.0, 0.005),
        "settling_time_5_percent_s": settling_time(t, travel, float(travel[-1]), 0.05 * 0.005),
        "overshoot_percent": 100.0 * overshoot(travel, float(travel[-1])),
        "steady_error_mm": 1e3 * float(abs(np.mean(travel[within(t, 3.0, 3.5)]) - 0.005)),
    }


def tracking(recording: Recording) -> dict[str, float]:
    """Of force and position while sweeping over the scale, on the truth."""
    run = Fig4Run(recording)
    return {
        "rms_force_error_N": rms(run.true_F_z[run.truly_at(*SWEEP)] - run.F_z_ref),
        "rms_z_error_mm": 1e3 * rms(run.true_z_error[run.at(*SWEEP)]),
        "trigger_time_s": run.trigger_time,
    }


def measured(drive: str, folder: Path) -> dict[str, dict[str, float]]:
    return {
        "step_z_air": step_response(recorded("step_z_air.toml", drive, folder / "step")),
        "fig4_force_position": tracking(recorded("fig4_force_position.toml", drive, folder / "fig4")),
    }


@pytest.mark.parametrize("drive", DRIVES)
def test_step_response_and_tracking_error_stay_where_they_were(drive: str, tmp_path: Path):
    baseline = json.loads((BASELINES / f"{drive}.json").read_text())
    now = measured(drive, tmp_path)
    for experiment, numbers in baseline.items():
        for name, before in numbers.items():
            # some are near zero, where a share of them says nothing: 2 mN, 2 um, 2 ms
            assert now[experiment][name] == pytest.approx(before, rel=TOLERANCE, abs=0.002), f"{experiment} {name}"


def main() -> None:
    for drive in DRIVES:
        with tempfile.TemporaryDirectory() as folder:
            numbers = {
                experiment: {name: float(f"{value:.5g}") for name, value in values.items()}
                for experiment, values in measured(drive, Path(folder)).items()
            }
        (BASELINES / f"{drive}.json").write_text(json.dumps(numbers, indent=2) + "\n")


if __name__ == "__main__":
    main()
