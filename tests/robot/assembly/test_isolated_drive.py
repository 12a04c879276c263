"""A process for each drive: the results of one process, and a crash that takes nothing but the drive."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.faulty import faulty_drive
from tests.kernel.process.hostile import HANG, HANG_IN_INITIALISATION, LEAK, NONE, SEGFAULT, SEGFAULT_IN_FREE, Command
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.guard import run_guarded
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import read
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.assembly.drives import drive as drive_here
from twin.robot.assembly.drives import plan_drive
from twin.robot.assembly.isolated_drive import IsolatedDrive, IsolatedDrives
from twin.robot.assembly.load import load_experiment
from twin.robot.live.runs import recorded_runs

REPORTER = DirectReporter(lambda note: None)


@pytest.mark.slow
def test_a_run_with_isolated_drives_gives_the_same_bytes(command: Command, drive: Path):
    recordings = []
    for isolation in ("drive", "none"):
        done = command.run(drive, NONE, "--isolate", isolation, "--set", "duration_s=1")
        assert done.returncode == 0, done.stderr
        recordings.append((command.folder / "x" / "run.mcap").read_bytes())
        (command.folder / "x").rename(command.folder / isolation)
    assert recordings[0] == recordings[1]
    assert command.survivors() == []
    assert command.leftovers() == []


@pytest.mark.slow
def test_a_run_in_which_power_is_taken_away_gives_the_same_bytes_however_isolated(root: Path, tmp_path: Path):
    runaway = 'fault=[{kind="drive_runaway", onset_s=0.3, magnitude_rad_per_s=2.0}]'
    settings = ["duration_s=1", "monitor.enabled=true", runaway]
    recordings = []
    for isolation in ("run", "drive", "none"):
        out = tmp_path / isolation
        arguments: dict[str, Any] = {
            "experiments": [str(root / "experiments" / "fig4_position.toml")], "settings": settings,
            "drive": "torque_motor_fmi3", "body": None, "out": str(out), "isolate_drives": isolation == "drive",
        }  # fmt: skip
        if isolation == "run":
            run_guarded("twin.robot.live.runs:recorded_runs", arguments)
        else:
            recorded_runs(REPORTER, **arguments)
        recordings.append((out / "run.mcap").read_bytes())
    assert recordings[0] == recordings[1] == recordings[2]
    power = read(tmp_path / "drive" / "run.mcap")["monitor.power"]
    assert power[0] and not power[-1]


@pytest.mark.slow
def test_an_isolated_drive_repeats_no_step_and_says_what_to_do(command: Command, drive: Path):
    done = command.run(drive, NONE, "--isolate", "drive", "--set", "cosim.iterations=2")
    assert done.returncode == 2
    assert done.stderr.endswith(
        ".fmu: a drive in a process of its own cannot go back to the start of a step, which iterations above 1 need; "
        "use iterations = 1, or --isolate run\n"
    )
    assert command.survivors() == []


@pytest.mark.endurance
def test_a_run_with_interpolated_inputs_and_isolated_drives_gives_the_same_bytes(command: Command, drive: Path):
    recordings = []
    for isolation in ("drive", "none"):
        done = command.run(drive, NONE, "--isolate", isolation, "--set", "cosim.inputs=linear", "--set", "duration_s=1")
        assert done.returncode == 0, done.stderr
        recordings.append((command.folder / "x" / "run.mcap").read_bytes())
        (command.folder / "x").rename(command.folder / isolation)
    assert recordings[0] == recordings[1]


@pytest.fixture(scope="module")
def single(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive that says it can live only once in a process."""
    flagged = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
    good, folder = root / "fmus" / "velocity_servo" / "velocity_servo.fmu", tmp_path_factory.mktemp("single")
    return redescribed(good, folder / "single.fmu", "<CoSimulation ", flagged)


def test_drives_that_fit_no_process_get_three_and_the_next_robot_gets_the_same(root: Path, single: Path):
    file = root / "experiments" / "fig4_position.toml"

    def ran(fmu: str) -> tuple[np.ndarray, list[int]]:
        with assemble(load_experiment(file, [], fmu)) as assembly:
            return simulation_of(assembly).run(), pids(assembly)

    first, theirs = ran(str(single))
    second, again = ran(str(single))
    assert len(theirs) == 3 and set(again) == set(theirs)
    assert np.array_equal(first, second)
    assert np.array_equal(first, ran("velocity_servo")[0])


def test_a_process_in_which_a_drive_has_failed_serves_no_other(root: Path, tmp_path: Path):
    flagged = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
    fmu = redescribed(faulty_drive(root, tmp_path), tmp_path / "once.fmu", "<CoSimulation ", flagged)
    experiment = load_experiment(root / "experiments" / "fig4_position.toml", ["drive.parameters.droop=1"], str(fmu))
    with assemble(experiment) as assembly:
        failed, simulation = pids(assembly)[0], simulation_of(assembly, 2000)
        with pytest.raises(ComponentFailed, match=r"once.fmu \(drive_1\) fmi2DoStep returned fmi2Error"):
            simulation.run()
    with assemble(experiment) as assembly:
        assert failed not in pids(assembly)


def test_two_parts_of_one_drive_cannot_be_an_fmu_that_lives_once(root: Path, single: Path):
    mapping = single.with_name("mapping.toml")
    mapping.write_text(
        '[parts]\na.fmu = "single.fmu"\nb.fmu = "single.fmu"\n'
        '[inputs]\nomega_ref = "a.omega_ref"\ntau_load = "a.tau_load"\n'
        '[outputs]\ntheta_m = "a.theta_m"\nomega_m = "b.omega_m"\n'
    )
    with pytest.raises(InputRefused, match="only once per process, and is used for two parts of one drive"):
        assemble(load_experiment(root / "experiments" / "fig4_position.toml", [], str(mapping)))


def simulation_of(assembly: Assembly, last_tick: int = 200) -> Simulation:
    return Simulation(assembly.system, last_tick)


def pids(assembly: Assembly) -> list[int]:
    """Of the processes of its drives."""
    return [c._process.pid for c in assembly.system.components if isinstance(c, IsolatedDrive)]


def test_an_isolated_drive_looks_like_the_drive_itself(root: Path):
    plan = plan_drive(load_experiment(root / "experiments/fig4_position.toml").drives[0])
    here = drive_here("drive_1", plan, 1e-3, 0.3, 0.05)
    with IsolatedDrives(REPORTER, step=10.0, count=1) as drives:
        there = drives.drive("drive_1", plan, 1e-3, 0.3, 0.05)
        assert (there.inputs, there.outputs, there.label) == (here.inputs, here.outputs, here.label)
        assert np.array_equal(there.initial_outputs, here.initial_outputs)
        there.close()
    here.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("attack", "manner"),
    [
        (SEGFAULT, "crashed (SIGSEGV, segmentation fault) in fmi2DoStep (report it to its supplier)"),
        (HANG, "did not return from fmi2DoStep within 1 s (if it is slow, not stuck, raise --limit-step)"),
    ],
)
def test_a_drive_that_kills_its_process_costs_no_row(command: Command, drive: Path, attack: int, manner: str):
    done = command.run(drive, attack, "--isolate", "drive", "--limit-step", "1")
    assert done.returncode == 3
    said = f"hostile.fmu (drive_2) {manner} in the step from t = 0.999 s, tick 999. Last inputs: omega_ref = "
    assert done.stderr.startswith(said)
    recording = read(command.folder / "x" / "run.mcap.partial")
    assert recording.time("plant")[-1] == 0.999
    assert recording.events[-1].text.startswith(said)
    assert command.survivors() == []
    assert command.leftovers() == []


@pytest.mark.slow
def test_an_isolated_drive_that_hangs_before_the_first_step_is_refused(command: Command, drive: Path):
    done = command.run(drive, HANG_IN_INITIALISATION, "--isolate", "drive", "--limit-step", "1")
    assert done.returncode == 2
    said = "hostile.fmu (drive_2) did not return within 1 s in fmi2ExitInitializationMode, before the first step."
    assert done.stderr.startswith(said)
    assert command.survivors() == []


@pytest.mark.slow
def test_an_isolated_drive_that_crashes_when_freed_is_named(command: Command, drive: Path):
    done = command.run(drive, SEGFAULT_IN_FREE, "--isolate", "drive")
    assert done.returncode == 3
    said = "crashed (SIGSEGV, segmentation fault) in fmi2FreeInstance, after the last step."
    assert done.stderr.startswith(f"hostile.fmu (drive_2) {said}")
    assert "The recording is complete: x/run.mcap." in done.stderr
    assert read(command.folder / "x" / "run.mcap").complete
    assert command.survivors() == []


@pytest.mark.endurance
def test_the_isolated_drive_that_leaks_is_the_one_that_is_named(command: Command, drive: Path):
    done = command.run(drive, LEAK, "--isolate", "drive", "--limit-memory", "800")
    assert done.returncode == 3
    assert done.stderr.startswith("hostile.fmu (drive_2) grew to the limit of 800 MB of memory in the step from t = ")
    assert command.survivors() == []


def test_what_an_isolated_drive_says_of_its_bad_status_is_told(root: Path, tmp_path: Path):
    fmu = faulty_drive(root, tmp_path)
    overrides = [f"drive.fmu='{fmu}'", "drive.parameters.droop=1"]
    plan = plan_drive(load_experiment(root / "experiments/fig4_position.toml", overrides).drives[0])
    with IsolatedDrives(REPORTER, step=10.0, count=1) as drives:
        there = drives.drive("drive_1", plan, 1e-3, 0.0, 0.0)
        simulation = Simulation(
            System([there], [("drive_1.omega_m", f"drive_1.{name}") for name in ("omega_ref", "tau_load")], 1e-3), 2000
        )
        while not simulation.is_over:
            simulation.advance()
        assert "faulty.fmu (drive_1) fmi2DoStep returned fmi2Error" in str(simulation.failure)
        there.close()
