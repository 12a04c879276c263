"""What `twin build --ssp` writes: files of the standard that give the twin's own run; what it refuses."""

import hashlib
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.ssp.test_ssd import complaints
from tests.studies.build.conftest import FIG4, ROOT, silent
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.variable import FilePath
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import read
from twin.kernel.ssp.package import read_package
from twin.kernel.ssp.structure import Endpoint, SspComponent, Transformation
from twin.kernel.systems.choice import MasterChoice
from twin.robot.assembly.build import planned_drives
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.build import joint_drive, linking
from twin.studies.build.joint_drive import travelling_drives
from twin.studies.build.system import build_ssp
from twin.studies.systems.recorded import record_system

VELOCITY_SERVO = ROOT / "fmus" / "velocity_servo" / "velocity_servo.fmu"
MASSAGE = ROOT / "experiments" / "massage.toml"
FINE = ("cosim.tick_ms=0.25",)
"""Short enough for drives whose loops are ours."""
SHORT = ("duration_s=8",)
"""Until after the force loop has been triggered."""
Built = Callable[..., Path]


@pytest.fixture(scope="session")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Builds an archive: `archived("duration_s=8")`, once for each."""
    folder, done = tmp_path_factory.mktemp("archived"), dict[tuple[object, ...], Path]()

    def build(*settings: str, experiment: Path = FIG4, fmi: str = "2.0", drive: str | None = None) -> Path:
        key = settings, experiment, fmi, drive
        if key not in done:
            done[key] = folder / f"{len(done)}.ssp"
            build_ssp(experiment, fmi, (), done[key], drive, settings, silent)
        return done[key]

    return build


def differences(
    file: Path, folder: Path, settings: tuple[str, ...], experiment: Path = FIG4, drive: str | None = None
) -> dict[str, float]:
    """How far what `twin cosim` makes of an archive is from the run of its experiment: by signal, of its range."""
    loaded = load_experiment(experiment, settings, drive)
    run = run_in_memory(loaded)
    came = record_system(
        DirectReporter(lambda note: None), file, MasterChoice(scheme=loaded.cosim.scheme), folder
    ).facts
    assert came["settled"] and came["tick_s"] == loaded.cosim.tick and not came["ignored"]
    theirs = read(folder / "run.mcap")
    angles = {
        c.start.element: c.transformation
        for c in read_package(file).structure.system.connections
        if c.end.connector.partition("[")[0] == "theta_m"
    }
    found = {}
    for signal in run.fields():
        component, _, name = signal.partition(".")
        ours = np.asarray(run.held(signal), dtype=float)
        if component.startswith("drive/"):
            element = component.replace("/", "_")
            bound = {b.port.name: b for plan in planned_drives(loaded)[:1] for b in plan.bindings}.get(name)
            # a command of ours is between elements
            if bound is None or bound.role.causality == "input":
                continue
            # what an FMU marks as local is recorded where something begins at it
            if bound.variable.causality == "local" and f"{element}.{bound.variable.name}" not in theirs.fields():
                continue
            line = angles[element] if name == "theta_m" else Transformation(bound.gain, bound.offset)
            there = line.factor * theirs[f"{element}.{bound.variable.name}"] + line.offset
        elif component.startswith("shaft_"):
            there = theirs[f"drive_{component[-1]}_unpowered.{component}_{name}"]
        elif component == "plant":
            there = theirs[signal]
        elif component == "bus" and loaded.cosim.scheme == "jacobi":
            # which is the other master's tick
            continue
        else:
            owner = {"scale": "plant", "body": "plant", "bus": "bus"}.get(component, "computer")
            there = theirs[signal if owner == component else f"{owner}.{component}_{name}"]
            # what is sampled is published at the end of the step
            there, ours = there[1:], ours[:-1]
        found[signal] = float(np.max(np.abs(there - ours))) / (float(np.ptp(ours)) or 1.0)
    return found


@pytest.mark.slow
def test_fig4_comes_back_bit_for_bit(archived: Built, tmp_path: Path) -> None:
    found = differences(archived(*SHORT), tmp_path / "run", SHORT)
    assert len(found) == 36 and set(found.values()) == {0.0}


UNPOWERED = (
    "drive.unpowered.holding_Nm=0.005", "drive.unpowered.brake_Nm=0.5", "drive.unpowered.brake_line=own",
    # trips at 4 N, no drive obeys so fast; brakes close while the shafts turn
    "monitor.enabled=true", "monitor.force_limit_N=4", "monitor.obey_lag_ms=2", "monitor.obey_delay_ms=0",
    "monitor.release_time_ms=20", *SHORT,
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "drive"),
    [
        (("controller.bus_delay_ticks=1",), None),
        pytest.param(("cosim.scheme=jacobi", "controller.bus_delay_ticks=1"), None, marks=pytest.mark.endurance),
        pytest.param((), "pmsm_foc", marks=pytest.mark.endurance),
        pytest.param((), "mx106", marks=pytest.mark.endurance),
    ],
)
def test_drives_without_power_come_back_bit_for_bit(
    archived: Built, tmp_path: Path, settings: tuple[str, ...], drive: str | None
) -> None:
    """The power is cut, the springs unwind against the gears, and brakes close on their own line."""
    asked = (*UNPOWERED, *settings)
    power, brake, shaft = (
        np.asarray(run_in_memory(load_experiment(FIG4, asked, drive)).held(signal), dtype=float)
        for signal in ("monitor.drive_power", "monitor.brake", "shaft_1.theta_m")
    )
    cut = int(np.argmax(power[:, 0] == 0.0))
    assert 0 < cut < len(power) and brake[-1] == 1.0 and np.ptp(shaft[cut:]) > 0.01
    found = differences(archived(*asked, drive=drive), tmp_path / "run", asked, drive=drive)
    assert {"shaft_3.theta_m", "monitor.brake"} <= set(found) and set(found.values()) == {0.0}


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("settings", "experiment", "fmi", "drive", "roundings"),
    [
        ((), FIG4, "2.0", None, 0.0),
        ((), MASSAGE, "3.0", None, 0.0),
        (("cosim.scheme=jacobi", "controller.bus_delay_ticks=1"), MASSAGE, "2.0", None, 0.0),
        (("controller.bus_delay_ticks=2", *SHORT), FIG4, "2.0", None, 0.0),
        *((SHORT, FIG4, "2.0", drive, 0.0) for drive in ("ideal_velocity", "pmsm_foc", "stepper", "xl330", "mx106")),
        # degrees on the wires: factor and division instead of one factor
        (SHORT, FIG4, "2.0", "smart_servo", 1e-11),
        ((*FINE, "duration_s=2"), FIG4, "2.0", "modelica_dc", 0.0),
        ((*FINE, "duration_s=2"), FIG4, "2.0", "brushed_dc", 1e-11),
    ],
)
def test_whatever_travels_comes_back(
    archived: Built, tmp_path: Path, settings: tuple[str, ...], experiment: Path, fmi: str, drive: str | None,
    roundings: float,
) -> None:  # fmt: skip
    file = archived(*settings, experiment=experiment, fmi=fmi, drive=drive)
    found = differences(file, tmp_path / "run", settings, experiment, drive)
    assert len(found) >= 27 and max(found.values()) <= roundings


def test_the_schemas_of_the_standard_have_nothing_against_it(archived: Built) -> None:
    with zipfile.ZipFile(archived(*SHORT)) as archive:
        for name in archive.namelist():
            schema = {".ssd": "Description", ".ssv": "ParameterValues"}.get(Path(name).suffix)
            assert schema is None or complaints(archive.read(name), schema) == [], name


def test_elements_stand_in_the_order_in_which_the_twin_steps_them(archived: Built) -> None:
    elements = read_package(archived(*SHORT)).structure.system.elements
    assert [element.name for element in elements] == ["computer", "drive_1", "drive_2", "drive_3", "plant"]
    assert [element.source for element in elements if isinstance(element, SspComponent)] == [
        f"resources/{name}.fmu" for name in ("computer", *["velocity_servo"] * 3, "plant")
    ]


def test_values_have_their_units_and_say_where_they_come_from(archived: Built) -> None:
    experiment = load_experiment(FIG4)
    computer, drive, *_, plant = (
        {value.name: value for value in element.bindings[0].parameters.parameters}
        for element in read_package(archived(*SHORT)).structure.system.elements
    )
    for values in (computer, drive, plant):
        assert all(value.unit for value in values.values())
    stiffness, droop = plant["plant.k_s_Nm_per_rad"], drive["droop"]
    assert (stiffness.values, stiffness.unit) == ((1.0,), "Nm/rad")
    # the plant's table has what the robot's says
    assert stiffness.description == experiment.origins["robot.k_s_Nm_per_rad"]
    assert (droop.values, droop.unit) == ((0.6,), "rad/(s.N.m)")
    assert droop.description == experiment.origins["drive.parameters.droop"]
    gain = computer["controller.force.kp_mm_per_N"]
    assert gain.unit == "mm/N" and gain.description == experiment.origins["controller.force.kp_mm_per_N"]


def test_it_says_what_it_was_made_of(archived: Built) -> None:
    file = archived(*SHORT)
    note = read_package(file).structure.system.annotations[1]
    stated = dict(re.findall(r'source="([^"]+)" sha256="([0-9a-f]{64})"', note.content))
    assert dict(re.findall(r'name="([a-z]+)" version="([^"]+)"', note.content)).keys() >= {"twin", "numba"}
    with zipfile.ZipFile(file) as archive:
        entries = {name for name in archive.namelist() if name.startswith("resources/")}
        assert stated == {name: hashlib.sha256(archive.read(name)).hexdigest() for name in entries}
        assert archive.read("resources/velocity_servo.fmu") == VELOCITY_SERVO.read_bytes()
        told = archive.read("documentation/README.md").decode()
    assert "(Gauss-Seidel)" in told and all(digest in told for digest in stated.values())


def test_a_drive_counts_from_where_the_robot_rests(archived: Built) -> None:
    connections = read_package(archived(*SHORT)).structure.system.connections
    rest = run_in_memory(load_experiment(FIG4, ["duration_s=0.001"])).of_drives("theta_m")[0]
    for part in ("computer", "plant"):
        for number, angle in enumerate(rest, start=1):
            (line,) = (c for c in connections if c.end == Endpoint(part, f"theta_m[{number}]"))
            assert (line.start, line.transformation.factor) == (Endpoint(f"drive_{number}", "theta_m"), 1.0)
            assert line.transformation.offset == angle and line.suppress_unit_conversion


def test_a_position_command_of_ours_travels_as_an_fmu_in_front_of_each_drive() -> None:
    joints = travelling_drives(load_experiment(FIG4, (), "xl330"))
    for number, joint in enumerate(joints, start=1):
        names = [f"drive_{number}_position_command", f"drive_{number}"]
        assert [element.name for element in joint.elements] == names
        leads = [(source.variable, target.variable) for source, target in joint.connections]
        assert leads == [("theta_m", "theta_m"), ("position_command.goal", "goal_position")]
        assert [socket.element for socket in joint.inputs["omega_ref"]] == names[:1]


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (["cosim.scheme=jacobi"], "which is a bus of 1 tick; build it with --set controller.bus_delay_ticks=1"),
        (["cosim.iterations=2"], "build it with --set cosim.iterations=1"),
        (["cosim.inputs=linear"], "build the plant with --set cosim.inputs=hold"),
        ([f"controller.python={ROOT}/examples/my_controller.py:Controller"], "only twin's own parts can be exported"),
        # which no part of ours would miss
        (['fault=[{kind="drive_runaway", onset_s=6.0, magnitude_rad_per_s=2.0}]'], "--set fault=[]"),
        (['change=[{t_s=1.0, key="controller.force.reference_N", value=4.0}]'], "--set change="),
    ],
)
def test_an_experiment_that_an_ssp_cannot_say_is_refused(tmp_path: Path, settings: list[str], told: str) -> None:
    with pytest.raises(InputRefused, match=re.escape(told)) as refused:
        build_ssp(FIG4, "2.0", (), tmp_path / "x.ssp", None, settings, silent)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("drive", "settings", "told"),
    [
        ("brushed_dc", [], r"makes 4 steps in a tick of 1 ms, as twin's \[drive.velocity_loop\] acts"),
        ("velocity_servo", ["drive.substeps=3"], r"makes 3 steps .* \[drive\] substeps requires them"),
        ("modelica_dc", ["drive.kind=model_exchange"], "is used for model exchange, with a solver of twin"),
        ("velocity_servo", ["drive.tolerance=1e-6"], r"\[drive\] tolerance cannot be expressed"),
        ("once", [], "only once per process, so that three joints need three processes"),
        ("torque_motor_fmi3", [*FINE, "monitor.enabled=true"], "its input enable is of type Boolean"),
    ],
)
def test_a_drive_that_needs_our_master_is_refused(tmp_path: Path, drive: str, settings: list[str], told: str) -> None:
    if drive == "once":
        flagged = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
        drive = str(redescribed(VELOCITY_SERVO, tmp_path / "once.fmu", "<CoSimulation ", flagged))
    with pytest.raises(InputRefused, match=told) as refused:
        travelling_drives(load_experiment(FIG4, settings, drive))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("value", "size", "told"), [([FilePath("map.csv")], 1, "droop is a file"), (0.5, 3, "droop is an array")]
)
def test_files_and_arrays_do_not_travel(value: Any, size: int, told: str) -> None:
    (plan, *_) = planned_drives(load_experiment(FIG4))
    ((variable, _),) = plan.settings[""]
    with pytest.raises(InputRefused, match=told):
        joint_drive._refuse_unexportable(replace(plan, settings={"": [(replace(variable, size=size), value)]}), 0.001)


def test_without_a_compiler_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*asked: object) -> None:
        raise InputRefused("x.ssp: no C compiler")

    monkeypatch.setattr(linking, "_compiler", none)
    with pytest.raises(InputRefused, match="no C compiler"):
        build_ssp(FIG4, "2.0", (), tmp_path / "x.ssp", None, (), silent)
    assert not list(tmp_path.iterdir())
