"""Whatever integer a function of an FMU returns, the run ends with its name or goes on as the standard says."""

import gc
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.odd import SOURCE, odd_fmu
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.fmi import floating_point
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system
from twin.kernel.systems.reading import read_system
from twin.kernel.systems.session import Cosimulation

NUMBERS = (-1, *range(7), 15, 16, 64, 128, 2**31 - 1)
NAMES = {2: "Discard", 3: "Error", 4: "Fatal", 5: "Pending"}
INITIALISING = ("SetupExperiment", "EnterInitializationMode", "ExitInitializationMode")
STEPPING = ("SetReal", "GetReal", "DoStep")
EXCHANGE = (
    "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode", "SetTime", "SetContinuousStates",
    "GetDerivatives", "GetEventIndicators", "GetContinuousStates", "CompletedIntegratorStep",
    "GetNominalsOfContinuousStates",
)  # fmt: skip
STATES = (
    "GetFMUstate", "SetFMUstate", "FreeFMUstate", "SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate",
)  # fmt: skip
CASES = [
    *(("2.0", "CoSimulation", name, after) for name in (*INITIALISING, *STEPPING) for after in (0, 2)),
    *(("3.0", "CoSimulation", name, after) for name in ("SetFloat64", "GetFloat64", "DoStep") for after in (0, 2)),
    *(("3.0", "CoSimulation", name, 0) for name in ("EnterInitializationMode", "ExitInitializationMode")),
    *(("3.0", "CoSimulation", name, 0) for name in ("UpdateDiscreteStates", "EnterStepMode")),
    *(("2.0", "ModelExchange", name, after) for name in EXCHANGE for after in (0, 2)),
    *((version, "CoSimulation", name, 0) for version in ("2.0", "3.0") for name in STATES),
]


def run(fmu: Path, kind: str, states: bool) -> None:
    """A run with an input that moves, by equations with Runge-Kutta, in whose middle it goes back to its start."""
    choice = MasterChoice(kinds={"": "model_exchange"}, solver="rk4") if kind == "ModelExchange" else MasterChoice()
    name = "in_Real" if fmu.stem == "two" else "in_Float64"
    with open_system(read_system(fmu), choice, additions=Additions(inputs=[f"{name}=t"])) as (plan, made):
        simulation = Simulation(made.system, plan.timing.ticks)
        if states:
            simulation.advance(1)
            saved = simulation.state().saved()
            simulation.restore(saved)
        simulation.run()


@pytest.mark.parametrize(("version", "kind", "name", "after"), CASES)
def test_every_function_may_return_any_integer(version: str, kind: str, name: str, after: int, tmp_path: Path):
    fmu_name, real = ("two.fmu", "Real") if version == "2.0" else ("three.fmu", "Float64")
    prefix = f"fmi{version[0]}"
    abilities = 'hasEventMode="true"' if name in ("UpdateDiscreteStates", "EnterStepMode") else ""
    called = f"{prefix}{name}" if version == "2.0" else f"{prefix}{name}".replace("FMUstate", "FMUState")
    called = called.replace("DeSerialize", "Deserialize") if version == "3.0" else called
    for number in NUMBERS:
        fmu = odd_fmu(tmp_path / fmu_name, f"{name} {number} {after}", (real,), kind, abilities=abilities)
        goes_on = number in (0, 1)
        # what is called at the start alone is not called after two steps
        never = after == 2 and name in INITIALISING
        try:
            run(fmu, kind, name in STATES)
        except TwinError as failure:
            assert isinstance(failure, ComponentFailed | InputRefused) and failure.exit_code in (2, 3)
            known = number in NAMES and (number < 5 or called == "fmi2DoStep")
            told = f"returned {prefix}{NAMES[number]}" if known else f"returned {number}, which is not a status of FMI"
            discarded = name == "DoStep" and number == 2
            assert not goes_on and not never, failure
            assert fmu_name in str(failure)
            assert discarded or f"{called} {told}" in str(failure), failure
        else:
            # nominal values are asked for at the start, and FreeFMUstate when a state is no longer needed
            assert goes_on or never or name in ("GetNominalsOfContinuousStates", "FreeFMUstate") or (number, name) == (
                2, "DoStep"
            ), number  # fmt: skip


def test_a_getter_that_fails_names_its_variable_and_what_was_logged(tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu", "GetInteger 3 0", ("Real", "Integer"))
    said = (
        "x.fmu (x) fmi2GetInteger returned fmi2Error for out_Integer at the start (it logged: GetInteger of in_Real and"
    )
    with pytest.raises(ComponentFailed) as failure, open_system(read_system(fmu)):
        pass
    assert str(failure.value).startswith(said)


def test_references_in_log_messages_become_names(tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu", "DoStep 1 1", ("Real", "Integer"))
    with open_system(read_system(fmu)) as (plan, made):
        Simulation(made.system, plan.timing.ticks).run()
        ((_, text),) = {text: (tick, text) for tick, text in made.system.components[0].take_messages()}.values()
    assert text == "DoStep of in_Real and in_Integer, #1"


@pytest.mark.parametrize(
    "function", ["Instantiate", "EnterInitializationMode", "SetReal", "GetReal", "DoStep", "ExitInitializationMode"]
)
def test_an_fmu_that_changes_the_working_directory_leaves_it_as_it_was_and_that_is_told(function: str, tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu", f"{function} 0 0 /")
    here = os.getcwd()
    with open_system(read_system(fmu), additions=Additions(inputs=["in_Real=t"])) as (plan, made):
        simulation = Simulation(made.system, plan.timing.ticks)
        simulation.run()
        told = [text for _, text in made.system.components[-1].take_messages()]
        assert os.getcwd() == here
    assert told == ([] if function == "Instantiate" else ["changed the working directory; it is back where it was"])


@pytest.mark.skipif(floating_point.mode() == floating_point.Mode(), reason="the mode is not known on this platform")
@pytest.mark.parametrize("function", ["EnterInitializationMode", "SetReal", "GetReal", "DoStep"])
def test_an_fmu_that_changes_how_the_processor_rounds_does_not_change_it_for_others(function: str, tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu", f"{function} 0 0 UPWARD")
    third, before = np.float64(1.0), floating_point.mode()
    with open_system(read_system(fmu), additions=Additions(inputs=["in_Real=t"])) as (plan, made):
        simulation = Simulation(made.system, plan.timing.ticks)
        simulation.run()
        reported = [text for _, text in made.system.components[-1].take_messages()]
        assert floating_point.mode() == before and third / 3.0 == float.fromhex("0x1.5555555555555p-2")
    assert reported == ["changed the floating-point mode (rounding, tiny numbers); it is as it was"]


def test_a_library_that_flushes_tiny_numbers_when_it_is_loaded_does_not_do_so_for_others(tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu")
    _loading_flushes(fmu)
    with open_system(read_system(fmu), additions=Additions(inputs=["in_Real=1e-310*(1+t)"])) as (plan, made):
        rows = Simulation(made.system, plan.timing.ticks).run()
    assert rows[-1].min() > 0.0


def _loading_flushes(fmu: Path) -> None:
    """Replace the library of an FMU by one that gcc links as it does with -Ofast."""
    library = fmu.with_suffix(".so")
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs gcc")
    act = "__builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);"
    start = f"__attribute__((constructor)) static void start(void) {{ {act} }}"
    source = fmu.with_suffix(".c")
    source.write_text(f'#include "{SOURCE}"\n{start}\n')
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-w", source, "-o", library, "-lm"], check=True)
    with zipfile.ZipFile(fmu) as archive:
        kept = {name: archive.read(name) for name in archive.namelist() if not name.endswith(".so")}
        (place,) = (name for name in archive.namelist() if name.endswith(".so"))
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in {**kept, place: library.read_bytes()}.items():
            archive.writestr(name, content)


def test_a_local_that_cannot_be_read_is_left_out_and_listed(tmp_path: Path):
    more = '<ScalarVariable name="l" valueReference="9" causality="local"><Integer/></ScalarVariable>'
    fmu = odd_fmu(tmp_path / "x.fmu", "GetInteger 3 0", more=more)
    with open_system(read_system(fmu), additions=Additions(recorded=["*"])) as (plan, made):
        assert plan.unreadable == ("x.l",)
        assert [port.variable.name for port in plan.parts[0].outputs] == ["in_Real", "out_Real"]
        assert Simulation(made.system, plan.timing.ticks).run().shape[1] == 2


def test_a_state_that_an_fmu_does_not_free_is_a_message_and_ends_nothing(tmp_path: Path):
    fmu = odd_fmu(tmp_path / "x.fmu", "FreeFMUstate 3 0")
    with open_system(read_system(fmu)) as (plan, made):
        simulation = Simulation(made.system, plan.timing.ticks)
        simulation.advance(1)
        state = simulation.state()
        (part,) = made.system.components
        part.take_messages()
        # as when nothing refers to it any more: a warning that nobody could catch would fail this test
        del state
        gc.collect()
        (logged, reported) = [text for _, text in part.take_messages()]
        assert logged.startswith("FreeFMUstate of ")
        assert reported.startswith("x.fmu: fmi2FreeFMUstate failed: fmi2FreeFMUstate returned fmi2Error")
        simulation.run()


@pytest.mark.parametrize(("odd", "value", "word"), [("NaN 0", np.nan, "NaN"), ("Inf -1", -np.inf, "infinity")])
def test_an_output_that_is_not_finite_is_recorded_with_one_note_where_nothing_reads_it_and_ends_the_run_elsewhere(
    odd: str, value: float, word: str, tmp_path: Path
):
    fmu = odd_fmu(tmp_path / "x.fmu", f"{odd} 2")
    with open_system(read_system(fmu)) as (plan, made):
        rows = Simulation(made.system, plan.timing.ticks).run()
        (part,) = made.system.components
        assert part.take_messages() == [(1, "returns NaN or infinity for out_Real, which nothing reads")]
        assert part.take_messages() == []
    np.testing.assert_array_equal(rows[2:, 0], value)
    assert np.all(np.isfinite(rows[:2, 0]))
    other = odd_fmu(tmp_path / "y.fmu")
    with Cosimulation(0.1, 0.5) as joined:
        joined.load("x", fmu)
        joined.load("y", other)
        joined.wire("x.out_Real", "y.in_Real")
        said = rf"x.fmu \(x\) returned {word} for out_Real in the step from t = 0.1 s"
        with pytest.raises(ComponentFailed, match=said):
            joined.run()
