"""From loading to step mode: what an FMU is told, how quickly it is loaded, and FMI 1.0."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import fmi2, fmi3

from tests.command_line import twin
from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.compiled import compiled_drive
from tests.kernel.fmi.first import first_description, first_drive, first_library
from tests.kernel.fmi.test_component import TICK, made, run
from tests.kernel.fmi.test_event_step import stepped
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.description import described
from twin.kernel.fmi.lifecycle import CosimInstance, FMU2Drive, FMU3Drive
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setup
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import read
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.experiment.schema import Drive
from twin.studies.qualify import drive_list as drive_info
from twin.studies.qualify.proposal import proposal
from twin.studies.qualify.qualification import check_fields

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
        drive("drive_1", plan_drive(Drive.model_validate({"fmu": str(exact_drive)})), 1e-3, 0.0, 0.0)
    stated = redescribed(exact_drive, tmp_path / "stated.fmu", *stating("1e-9"))
    plan = plan_drive(Drive.model_validate({"fmu": str(stated)}))
    assert plan.tolerance("") == 1e-9
    drive("drive_1", plan, 1e-3, 0.0, 0.0).close()


@pytest.mark.parametrize("text", ["none", "-1", "0", "1e400", ""])
def test_a_stated_tolerance_that_is_none_is_left_alone(root: Path, tmp_path: Path, text: str):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    odd = redescribed(good, tmp_path / "odd.fmu", *stating(text))
    assert plan_drive(Drive.model_validate({"fmu": str(odd)})).tolerance("") is None


@pytest.mark.parametrize(
    ("drive", "fmpy_slave", "slave"),
    [("velocity_servo", fmi2.FMU2Slave, FMU2Drive), ("torque_motor_fmi3", fmi3.FMU3Slave, FMU3Drive)],
)
def test_the_functions_of_a_second_slave_are_its_own_binarys_with_fmpys_signatures(
    root: Path, drive: str, fmpy_slave: type, slave: type, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("twin.kernel.fmi.lifecycle._complete", set())
    fmu = described(root / "fmus" / drive / f"{drive}.fmu")
    folder = str(unpacked(fmu.path, fmu.sha256))
    said = {"guid": fmu.model.guid, "unzipDirectory": folder, "modelIdentifier": fmu.identifier}
    model, first, second = (made(instanceName="drive_1", **said) for made in (fmpy_slave, slave, slave))
    assert first._functions.keys() == model._functions.keys() and len(first._functions) > 20
    # which have to be there is known by now
    assert not second._functions
    for mine in (first, second):
        for name, known in model._functions.items():
            function = mine._functions[name]
            assert (function.argtypes, function.restype) == (known.argtypes, known.restype), name
            assert function is getattr(mine.dll, name)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux to see what is loaded")
def test_static_memory_of_a_binary_ends_with_its_last_instance(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    # unpacked where no other test has it loaded from
    fmu = described(root / "fmus" / "velocity_servo" / "velocity_servo.fmu")
    folder = unpacked(fmu.path, fmu.sha256)
    instances = [CosimInstance(f"drive_{joint}", fmu, folder) for joint in (1, 2, 3)]
    assert str(folder) in Path("/proc/self/maps").read_text()
    for instance in instances:
        instance.close()
    assert str(folder) not in Path("/proc/self/maps").read_text()


VARIES = 'canHandleVariableCommunicationStepSize="true"'
LINES = 'canInterpolateInputs="true"'
Maker = Callable[..., Path]


@pytest.fixture(scope="module")
def first(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Makes drives of one binary; arguments as of `first_description`."""
    folder = tmp_path_factory.mktemp("first")
    library = first_library(root, folder)
    made: list[Path] = []

    def make(*said: str, **more: str) -> Path:
        made.append(folder / f"first_{len(made)}.fmu")
        return first_drive(library, made[-1], first_description(*said, **more))

    return make


def plan(fmu: Path, **table: Any) -> Any:
    return replace(plan_drive(Drive.model_validate({"fmu": str(fmu), **table})), ticks=100)


def test_it_turns_as_it_is_told(first: Maker):
    component = drive("drive_1", plan(first()), TICK, 0.25, 0.0)
    out = stepped(component, lambda t: 2.0, 100)
    # sums of 100 increments
    assert out["theta_m"] == pytest.approx(0.25 + 2.0 * TICK * np.arange(101), rel=1e-14)


def test_its_booleans_are_one_byte_wide(first: Maker):
    fmu = described(first())
    instance = CosimInstance(
        "a", fmu, unpacked(fmu.path, fmu.sha256), [(fmu.variables["enable"], 0.0)], (), Setup(stop=1.0)
    )
    instance.write([(fmu.variables["omega_ref"], 1.0)])
    instance.advance(0.0, TICK)
    assert instance.read_floats([fmu.variables[name] for name in ("enable", "omega_m")]).tolist() == [0.0, 0.0]
    instance.close()
    instance.close()


def test_a_run_after_a_reset_is_that_of_a_new_instance(first: Maker):
    drive = Drive.model_validate({"fmu": str(first())})
    assert check_fields(DirectReporter(lambda note: None), drive, "reset")["verdict"] == "ok"


def test_its_status_is_a_number_and_what_it_logged_is_told(first: Maker):
    component = drive("drive_1", plan(first()), TICK, 0.0, 0.0)
    instance = component.instance  # type: ignore[attr-defined]
    with pytest.raises(ComponentFailed, match=r"fmiDoStep returned fmiError \('not initialised, no new step"):
        instance.advance(1.0, TICK)
    component.close()


def test_what_its_standard_does_not_fit_is_refused(first: Maker):
    with pytest.raises(InputRefused, match="needs its authoring tool"):
        described(first(kind="CoSimulation_Tool"))
    with pytest.raises(InputRefused, match=r"fmiInstantiate refused \(it logged: the GUID is another one\)"):
        made(first(guid="{other}"))


def test_info_and_new_know_it(first: Maker):
    fmu = first()
    assert "FMI 1.0 co-simulation" in drive_info.drive_text(plan(fmu))
    assert "steps of one size only" in drive_info.drive_text(plan(fmu))
    assert drive_info.drive_facts(plan(fmu))["fmus"][0]["get_set_state"] is False  # type: ignore[index]
    text, complete = proposal(described(fmu))
    assert complete and 'theta_m = "theta_m"' in text


def test_a_discarded_step_goes_on_where_it_got_to(first: Maker):
    told = {"parameters": {"longest": 0.3e-3}}
    component = drive("drive_1", plan(first(VARIES), **told), TICK, 0.0, 0.0)
    out = stepped(component, lambda t: 1.0, 100)
    # sums of 400 parts of steps
    assert out["theta_m"] == pytest.approx(TICK * np.arange(101), rel=1e-13)
    assert "it discards steps" in component.take_messages()[0][1]
    component = drive("drive_1", plan(first(), **told), TICK, 0.0, 0.0)
    with pytest.raises(ComponentFailed) as failure:
        run(component, 1.0, 0.0)
    assert "fmiDoStep returned fmiDiscard; it may do with shorter steps: raise [drive] substeps" in str(failure.value)
    # as long as it takes: three steps of a third each
    fine = drive("drive_1", plan(first(), **told, substeps=4), TICK, 0.0, 0.0)
    assert stepped(fine, lambda t: 1.0, 100)["theta_m"][-1] == pytest.approx(0.1, rel=1e-13)


@pytest.mark.parametrize("longest", [1.0, 0.3e-3])
def test_an_input_that_rises_is_taken_as_a_line_within_the_step(first: Maker, longest: float):
    """Its slope is given with fmiSetRealInputDerivatives, and given again for every part of a discarded step."""
    told = {"parameters": {"longest": longest}}
    component = drive("drive_1", replace(plan(first(f"{VARIES} {LINES}"), **told), ramped=True), TICK, 0.0, 0.0)
    out = stepped(component, lambda t: 2.0 * t, 100, inputs="linear")
    t = TICK * np.arange(101)
    # rounding of 400 sums
    assert out["omega_m"] == pytest.approx(2.0 * t, rel=1e-12)
    assert out["theta_m"] == pytest.approx(t**2, abs=1e-15)
    held = drive("drive_1", replace(plan(first(VARIES)), ramped=True), TICK, 0.0, 0.0)
    late = stepped(held, lambda t: 2.0 * t, 100, inputs="linear")["omega_m"][1:]
    assert late == pytest.approx(2.0 * (t[1:] - 0.5 * TICK), rel=1e-12)
