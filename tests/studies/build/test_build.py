"""What `twin build --fmu` writes, and what it refuses before it writes anything."""

import importlib.util
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy.validation
import numpy as np
import pytest
from numba import carray

from tests.studies.build.conftest import FIG4, MODULES, silent
from twin.kernel.cosim.component import step_function
from twin.kernel.cosim.port import record
from twin.kernel.errors import InputRefused, NotWritten
from twin.robot.assembly.load import load_experiment
from twin.studies.build import linking
from twin.studies.build.fmu import build_fmu
from twin.studies.build.layout import layout_of
from twin.studies.build.library import build_c
from twin.studies.build.linking import HOST_PLATFORM, emit_step
from twin.studies.build.part import open_parameters, part_of
from twin.studies.build.system import build_ssp

SOFT = 'fault=[{kind="spring_broken", target="joint_1", onset_s=1.0}]'
BIAS = 'fault=[{kind="encoder_bias", onset_s=1.0, magnitude_deg=1.0}]'
JUMP = 'fault=[{kind="surface_jump", onset_s=1.0, magnitude_mm=1.0}]'


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("part", ["plant", "computer"])
def test_fmpy_finds_nothing_to_complain_of(built: Callable[..., Path], part: str, fmi: str) -> None:
    assert fmpy.validation.validate_fmu(str(built(part, fmi))) == []


def test_no_step_counts_references_allocates_or_is_of_one_processor(built: Callable[..., Path]) -> None:
    built("plant")
    built("computer")
    symbols = {symbol for symbol, _ in MODULES}
    assert {
        "step_plant",
        "step_plant_avx512",
        "begin_plant_0",
        "begin_plant_1",
        "step_estimator",
        "step_controller",
    } <= symbols
    for symbol, text in MODULES.items():
        for foreign in ("NRT_", "llvm.x86.", "Py", "numba_"):
            assert foreign not in text, (symbol, foreign)


def test_a_step_that_allocates_cannot_leave_python() -> None:
    @step_function(record(n="i8"))
    def step(m, t, h, u, y):  # type: ignore[no-untyped-def]
        kept = np.zeros(m.n)
        carray(y, 1)[0] = kept.sum()
        return 0

    with pytest.raises(InputRefused, match=r"its compiled step needs .*NRT_"):
        emit_step(step.module("step_of_mine"), HOST_PLATFORM, HOST_PLATFORM.forms[0])


def test_it_is_small_and_brings_no_file_beside_its_library(built: Callable[..., Path]) -> None:
    for part in ("plant", "computer"):
        with zipfile.ZipFile(built(part)) as archive:
            assert archive.namelist() == [
                f"binaries/linux64/{part}.so", "documentation/README.md", "modelDescription.xml"
            ]  # fmt: skip
        assert built(part).stat().st_size < 100_000


def test_parameters_are_called_and_said_as_in_the_file(built: Callable[..., Path]) -> None:
    variables = {v.name: v for v in fmpy.read_model_description(str(built("plant"))).modelVariables}
    stiffness, height = variables["plant.k_s_Nm_per_rad"], variables["contact.height_mm"]
    assert (stiffness.causality, stiffness.variability, stiffness.start) == ("parameter", "fixed", "1.0")
    assert stiffness.description == "stiffness of a joint's spring, on the motor's side, Eq. 18"
    unit = stiffness.declaredType or stiffness
    assert unit.unit == "Nm/rad"
    assert (height.start, height.unit) == ("-101.0", "mm")
    assert "plant.substeps" not in variables


def test_the_same_experiment_gives_the_same_bytes(built: Callable[..., Path], tmp_path: Path) -> None:
    # the controller: its way points lie elsewhere each time
    build_fmu(FIG4, "controller", "2.0", [], tmp_path / "again.fmu", [], silent)
    assert (tmp_path / "again.fmu").read_bytes() == built("controller").read_bytes()


@pytest.mark.parametrize(
    ("part", "settings", "sentence"),
    [
        ("plent", (), "no part of fig4_force_position that can be built; did you mean 'plant'"),
        ("monitor", (), "no part of fig4_force_position that can be built"),
        ("../plant", (), "no part of fig4_force_position that can be built"),
        ("drive_1", (), "a drive is an FMU already"),
        ("body", (), "its body does not move"),
        ("plant", ("cosim.inputs=linear",), "holds its inputs over a step"),
        ("computer", ("controller.fmu=fmus/parts/paper_law",), "third-party"),
        (
            "plant",
            (SOFT,),
            r"fault_1 \(spring_broken\) writes into the memory of plant.*build the sound plant with --set",
        ),
        ("fault_1", (SOFT,), "writes into the memory of plant, which no FMU can do to another; it cannot be built"),
        ("computer", (BIAS,), "between encoder and estimator, within computer; build its components one by one"),
        ("fault_1", (JUMP,), "is a motion of the body, and is built with it: expected body or plant"),
        ("fault_2", (BIAS,), "can be built; did you mean 'fault_1'"),
        (
            "computer",
            ('change=[{t_s=1.0, key="controller.force.reference_N", value=4.0}]',),
            r"has \[\[change\]\] tables",
        ),
    ],
)
def test_what_cannot_be_built_is_refused_in_a_sentence(
    tmp_path: Path, part: str, settings: tuple[str, ...], sentence: str
) -> None:
    with pytest.raises(InputRefused, match=sentence):
        build_fmu(FIG4, part, "2.0", [], tmp_path / "it.fmu", settings, silent)
    assert list(tmp_path.iterdir()) == []


def test_without_a_compiler_nothing_is_compiled_or_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputRefused, match=r"it\.fmu: no C compiler found; install one.*pip install ziglang"):
        build_fmu(FIG4, "plant", "2.0", [], tmp_path / "it.fmu", [], silent)
    assert list(tmp_path.iterdir()) == []


def test_a_compiler_that_refuses_is_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linking, "COMPILER_FLAGS", (*linking.COMPILER_FLAGS, "-Dint=nonsense"))
    with pytest.raises(InputRefused, match=r"it\.fmu: does not compile with cc: .*error"):
        build_fmu(FIG4, "encoder", "2.0", [], tmp_path / "it.fmu", [], silent)
    assert list(tmp_path.iterdir()) == []


def test_elsewhere_it_says_for_what_it_builds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(InputRefused, match="built on x86-64 Linux"):
        build_fmu(FIG4, "encoder", "2.0", [], tmp_path / "it.fmu", [], silent)


def test_a_file_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NotWritten):
        build_fmu(FIG4, "encoder", "2.0", [], tmp_path / "file" / "it.fmu", [], silent)


def test_a_place_that_cannot_be_written_is_said_before_anything_is_compiled(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done: list[str] = []
    for place, kind in (("file/it", NotWritten), ("", InputRefused)):
        with pytest.raises(kind):
            build_fmu(FIG4, "encoder", "2.0", [], tmp_path / place, [], done.append)
        with pytest.raises(kind):
            build_ssp(FIG4, "2.0", [], tmp_path / place, None, [], done.append)
    with pytest.raises(InputRefused):
        build_c(FIG4, [], tmp_path / "file", [], done.append)
    assert done == [] and [path.name for path in tmp_path.iterdir()] == ["file"]


def test_no_address_of_this_process_leaves_it() -> None:
    part = part_of(load_experiment(FIG4, ["controller.delay_ticks=2"]), "computer")
    layout = layout_of(part, open_parameters(part))
    assert len(layout.pointers) == 3
    for field, target in layout.pointers:
        assert layout.image[field : field + 8] == bytes(8)
        assert 0 < target < len(layout.image)
