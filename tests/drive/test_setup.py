"""What a drive is told of the run: until when, and how exactly its solver is to work."""

import json
import re
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.drive.archives import redescribed
from tests.drive.compiled import compiled_drive
from twin.errors import InputRefused
from twin.experiment.schema import Drive
from twin.recording.reader import read
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned

IGNORED = "(void)tolerance_defined, (void)tolerance, (void)stop_time_defined, (void)stop_time;"
SHORT = ("--set", "duration_s=0.7", "--set", "reference.t_s=[0, 0.7]", "--set", "reference.p_mm=[[0,0,-95],[0,0,-95]]")


def ends(text: str) -> str:
    """A drive that goes until the stop time and no further, and until 0.05 s if it is told none."""
    text = text.replace(
        IGNORED, "last = stop_time_defined ? stop_time : 0.05; (void)tolerance_defined, (void)tolerance;"
    )
    text = text.replace("fmi2Status fmi2SetupExperiment(", "static double last;\nfmi2Status fmi2SetupExperiment(")
    return text.replace("if (!(h > 0.0", "if (t + h > last) return fmi2Error;\n    if (!(h > 0.0")


def drifts(text: str) -> str:
    """A drive whose angle drifts by its tolerance (rad) in each second, 1e-4 if it is told none."""
    text = text.replace(
        IGNORED, "share = tolerance_defined ? tolerance : 1e-4; (void)stop_time_defined, (void)stop_time;"
    )
    text = text.replace("fmi2Status fmi2SetupExperiment(", "static double share;\nfmi2Status fmi2SetupExperiment(")
    return text.replace(
        "    slave->state.time = t + h;", "    slave->state.v.theta_m += share * h;\n    slave->state.time = t + h;"
    )


def exact(text: str) -> str:
    """A drive that wants a tolerance of 1e-9."""
    return text.replace(
        IGNORED,
        "(void)stop_time_defined, (void)stop_time; if (!tolerance_defined || tolerance != 1e-9) return fmi2Error;",
    )


def stating(tolerance: str) -> tuple[str, str]:
    """What of a description becomes what."""
    return "<DefaultExperiment ", f'<DefaultExperiment tolerance="{tolerance}" '


@pytest.fixture(scope="module")
def exact_drive(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_drive(root, tmp_path_factory.mktemp("exact"), "exact", {"lifecycle.c": exact})


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_drive_is_told_when_the_run_ends_and_is_never_stepped_beyond(root: Path, tmp_path: Path, substeps: int):
    # 0.7 / 0.001 / 3 is no number that sums exactly
    fmu = compiled_drive(root, tmp_path, "ends", {"lifecycle.c": ends})
    settings = (*SHORT, "--set", f"drive.substeps={substeps}")
    done = twin("run", root / "experiments/fig4_position.toml", "--drive", fmu, *settings, "--out", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(read(tmp_path / "run/run.mcap").metadata["fmu"]["drive_1"])
    # time is a number of ticks, and 700 x 1 ms is a bit more than the float 0.7
    assert (facts["stop_time"], facts["tolerance"]) == (700 * 1e-3, None)


def test_the_bench_tells_a_drive_too(root: Path, tmp_path: Path):
    fmu = compiled_drive(root, tmp_path, "ends", {"lifecycle.c": ends})
    done = twin("drive", "check", fmu, cwd=tmp_path)
    assert done.returncode == 0, done.stdout


def test_the_bench_tells_when_tolerance_and_not_step_is_the_error(root: Path, tmp_path: Path):
    fmu = compiled_drive(root, tmp_path, "drifts", {"lifecycle.c": drifts})
    done = twin("drive", "check", fmu, "--json", cwd=tmp_path)
    step = json.loads(done.stdout)["measures"]["step_error"]
    # 1e-4 rad/s over the seconds of the work cycle, less a hundredth
    found = re.fullmatch(r"with tolerance = 1e-06 it moves by (\S+) rad: set that", step["remark"])
    assert found and 1e-4 < float(found[1]) < 1e-3


def test_the_tolerance_of_the_experiment_reaches_the_solver_and_the_recording(exact_drive: Path, root: Path, tmp_path):
    run = ("run", root / "experiments/fig4_position.toml", "--drive", exact_drive, *SHORT, "--out", "run")
    refused = twin(*run, "--set", "drive.tolerance=1e-6", cwd=tmp_path)
    assert refused.returncode == 2 and "cannot be initialised" in refused.stderr
    done = twin(*run, "--set", "drive.tolerance=1e-9", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(read(tmp_path / "run/run.mcap").metadata["fmu"]["drive_1"])["tolerance"] == 1e-9


def test_without_one_the_tolerance_is_what_the_fmu_states(exact_drive: Path, tmp_path: Path):
    with pytest.raises(InputRefused, match="cannot be initialised"):
        drive("drive_1", planned(Drive.model_validate({"fmu": str(exact_drive)})), 1e-3, 0.0, 0.0)
    stated = redescribed(exact_drive, tmp_path / "stated.fmu", *stating("1e-9"))
    plan = planned(Drive.model_validate({"fmu": str(stated)}))
    assert plan.tolerance("") == 1e-9
    drive("drive_1", plan, 1e-3, 0.0, 0.0).close()


@pytest.mark.parametrize("text", ["none", "-1", "0", "1e400", ""])
def test_a_stated_tolerance_that_is_none_is_left_alone(root: Path, tmp_path: Path, text: str):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    odd = redescribed(good, tmp_path / "odd.fmu", *stating(text))
    assert planned(Drive.model_validate({"fmu": str(odd)})).tolerance("") is None
