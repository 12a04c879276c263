"""The FMI 3.0 ceremony: the package, what is refused, and what a state holds."""

import zipfile
from ctypes import c_bool, c_void_p

import pytest
from builder.compile import TARGETS_FMI3
from builder.drive import drive_names, load_drive
from builder.model_description_fmi3 import model_description_fmi3
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import fmi3Error
from fmpy.validation import validate_fmu

from .rig import described, fmu_path
from .rig_fmi3 import Rig3

pytestmark = pytest.mark.parametrize("drive", drive_names("3.0"))

MAGIC = {"x86_64-linux": b"\x7fELF", "x86_64-windows": b"MZ"} | dict.fromkeys(
    ("x86_64-darwin", "aarch64-darwin"), b"\xcf\xfa\xed\xfe"
)
BAD_NUMBERS = [float("nan"), float("inf"), float("-inf")]


def refusal(rig: Rig3, error: pytest.ExceptionInfo[FMICallException]) -> str:
    """The one message that came with a refused call."""
    assert error.value.status == fmi3Error
    [(status, text)] = rig.messages
    assert status == fmi3Error
    return text


def moving(drive: str) -> Rig3:
    """A drive in the middle of something, at 7 ms."""
    rig = Rig3(drive).start(tau_cmd=0.05, tau_load=0.03)
    rig.run(1e-3, 7)
    return rig


def test_the_description_is_valid(drive: str) -> None:
    assert validate_fmu(str(fmu_path(drive))) == []


def test_the_binaries_were_built_from_these_sources(drive: str) -> None:
    stale = f"fmus/{drive}/{drive}.fmu is stale: run python fmus/build.py {drive}"
    loaded = load_drive(drive)
    with zipfile.ZipFile(fmu_path(drive)) as archive:
        assert archive.read("modelDescription.xml") == model_description_fmi3(loaded), stale
        for source in loaded.sources:
            assert archive.read(f"sources/{source.name}") == source.read_bytes(), stale
        readme = fmu_path(drive).with_name("README.md").read_bytes()
        assert archive.read("documentation/README.md") == readme, stale
        for platform, (suffix, _) in TARGETS_FMI3.items():
            library = archive.read(f"binaries/{platform}/{drive}.{suffix}")
            assert library.startswith(MAGIC[platform])
            # the token compiled into the library is what fmi3InstantiateCoSimulation compares with
            assert loaded.guid.encode() in library, stale


def test_outputs_declare_no_direct_feed_through(drive: str) -> None:
    description = described(drive)
    outputs = {unknown.variable.name: unknown.dependencies for unknown in description.outputs}
    assert outputs == {v.name: [] for v in description.modelVariables if v.causality == "output"}


def test_variables_come_in_four_types_and_no_clock(drive: str) -> None:
    types = {v.name: v.type for v in described(drive).modelVariables}
    assert set(types.values()) == {"Float64", "Float32", "Int32", "Boolean"}
    assert not described(drive).coSimulation.hasEventMode


def test_a_temperature_in_degrees_celsius_says_how_far_from_kelvin(drive: str) -> None:
    [unit] = [unit for unit in described(drive).unitDefinitions if unit.name == "degC"]
    assert (float(unit.baseUnit.factor), float(unit.baseUnit.offset)) == (1.0, 273.15)


def test_a_wrong_instantiation_token_is_refused(drive: str) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        Rig3(drive, token="{00000000-0000-0000-0000-000000000000}")


def test_event_mode_is_refused(drive: str) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        Rig3(drive, event_mode=True)


def test_model_exchange_is_refused(drive: str) -> None:
    with Rig3(drive) as rig:
        arguments = (b"x", b"", b"", c_bool(False), c_bool(False), c_void_p(), rig.slave.logMessage)
        assert rig.slave.fmi3InstantiateModelExchange(*arguments) is None
        assert rig.messages == [(fmi3Error, "this FMU offers co-simulation only")]


def test_start_values_are_those_of_the_description(drive: str) -> None:
    with Rig3(drive) as rig:
        for variable in described(drive).modelVariables:
            if variable.causality != "independent":
                value = rig[variable.name]
                start = variable.start == "true" if variable.type == "Boolean" else float(variable.start)
                assert value == start


def test_time_is_a_variable_that_only_steps_move(drive: str) -> None:
    with moving(drive) as rig:
        assert rig["time"] == rig.time
        with pytest.raises(FMICallException) as error:
            rig["time"] = 1.0
        assert refusal(rig, error) == "fmi3SetFloat64: time moves only with a step"


def test_a_step_reports_its_end_and_nothing_to_react_to(drive: str) -> None:
    with moving(drive) as rig:
        assert rig.slave.doStep(rig.time, 1e-3) == (False, False, False, rig.time + 1e-3)


@pytest.mark.parametrize("h", [0.0, -1e-3, *BAD_NUMBERS])
def test_a_step_size_that_is_not_positive_and_finite_is_refused(drive: str, h: float) -> None:
    with moving(drive) as rig:
        before = rig.values()
        with pytest.raises(FMICallException) as error:
            rig.step(h)
        assert "communicationStepSize" in refusal(rig, error)
        assert rig.values() == before


def test_calls_out_of_turn_are_refused(drive: str) -> None:
    with Rig3(drive) as rig:
        with pytest.raises(FMICallException) as error:
            rig.step(1e-3)
        assert refusal(rig, error) == "fmi3DoStep is not allowed in mode instantiated"
    with moving(drive) as rig:
        with pytest.raises(FMICallException) as error:
            rig.slave.enterInitializationMode()
        assert refusal(rig, error) == "fmi3EnterInitializationMode is not allowed in mode step"
        theta_m = rig["theta_m"]
        rig.slave.terminate()
        assert rig["theta_m"] == theta_m


def test_a_variable_answers_only_to_its_own_type(drive: str) -> None:
    with moving(drive) as rig:
        reference = rig.variables["enable"].valueReference
        for read, kind in ((rig.slave.getFloat64, "Float64"), (rig.slave.getInt32, "Int32")):
            rig.messages.clear()
            with pytest.raises(FMICallException) as error:
                read([reference])
            assert refusal(rig, error) == f"fmi3Get{kind}: variable {reference} is a Boolean"


def test_unknown_references_and_wrong_counts_are_refused(drive: str) -> None:
    with moving(drive) as rig:
        unknown = max(v.valueReference for v in described(drive).modelVariables) + 1
        with pytest.raises(FMICallException) as error:
            rig.slave.getFloat64([unknown])
        assert f"unknown value reference {unknown}" in refusal(rig, error)
        rig.messages.clear()
        with pytest.raises(FMICallException) as error:
            rig.slave.getFloat64([0, 1], nValues=3)
        assert refusal(rig, error) == "fmi3GetFloat64: 3 values for 2 scalars"


@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_a_refused_value_leaves_its_neighbours_unset_too(drive: str, value: float) -> None:
    with moving(drive) as rig:
        references = [rig.variables[name].valueReference for name in ("tau_cmd", "tau_load")]
        with pytest.raises(FMICallException) as error:
            rig.slave.setFloat64(references, [1.0, value])
        assert refusal(rig, error) == f"fmi3SetFloat64: tau_load = {value:g} is not finite"
        assert rig["tau_cmd"] == 0.05


def test_a_result_that_is_not_finite_is_an_error(drive: str) -> None:
    with Rig3(drive).start(theta_m=1.7e308, omega_m=1.7e308, tau_load=-1.7e308) as rig:
        with pytest.raises(FMICallException) as error:
            rig.step(10e-3)
        assert "the result is not finite" in refusal(rig, error)


def test_only_inputs_can_be_set_once_the_drive_runs(drive: str) -> None:
    for variable in described(drive).modelVariables:
        if variable.causality in ("input", "independent"):
            continue
        with moving(drive) as rig:
            with pytest.raises(FMICallException) as error:
                rig[variable.name] = rig[variable.name]
            assert "can only be set before the first step" in refusal(rig, error)


def test_parameters_outside_their_bounds_are_refused(drive: str) -> None:
    with Rig3(drive) as rig:
        with pytest.raises(FMICallException) as error:
            rig["R"] = -1.0
        assert refusal(rig, error) == "fmi3SetFloat64: R = -1 is outside 1e-06 to inf"


def test_reset_gives_a_new_drive(drive: str) -> None:
    with Rig3(drive) as fresh, moving(drive) as rig:
        rig.slave.reset()
        assert rig.values() == fresh.values()
        rig.time = 0.0
        for instance in (fresh, rig):
            instance.start(tau_cmd=-0.2).run(1e-3, 10)
        assert rig.values() == fresh.values()


def test_a_restored_state_repeats_the_future_bit_for_bit(drive: str) -> None:
    with moving(drive) as rig:
        state = rig.slave.getFMUState()
        rig.run(0.7e-3, 10)
        first = rig.values()
        rig["tau_cmd"] = 0.3
        rig.step(1e-3)
        rig.slave.setFMUState(state)
        rig.time = 7e-3
        rig.run(0.7e-3, 10)
        assert rig.values() == first
        rig.slave.freeFMUState(state)
        assert state.value is None


def test_a_serialised_state_moves_to_another_instance_and_a_truncated_one_does_not(drive: str) -> None:
    with moving(drive) as rig, Rig3(drive) as other:
        state = rig.slave.getFMUState()
        data = rig.slave.serializeFMUState(state)
        copy = other.slave.deserializeFMUState(data)
        other.slave.setFMUState(copy)
        other.time = rig.time
        for instance in (rig, other):
            instance.run(1e-3, 5)
        assert other.values() == rig.values()
        with pytest.raises(FMICallException) as error:
            rig.slave.deserializeFMUState(data[:-1])
        assert "a state has" in refusal(rig, error)
        rig.slave.freeFMUState(state)
        other.slave.freeFMUState(copy)


def test_three_instances_do_not_share_memory(drive: str) -> None:
    with Rig3(drive).start(tau_cmd=0.04) as alone:
        alone.run(1e-3, 30)
        expected = alone.values()
    with Rig3(drive) as one, Rig3(drive) as two, Rig3(drive) as three:
        for instance, tau_cmd in ((one, 0.04), (two, -0.5), (three, 0.2)):
            instance.start(tau_cmd=tau_cmd)
        for _ in range(30):
            for instance in (one, two, three):
                instance.step(1e-3)
        assert one.values() == expected


def test_what_the_description_does_not_offer_is_refused(drive: str) -> None:
    calls = {
        "fmi3EnterEventMode": lambda rig: rig.slave.enterEventMode(),
        "fmi3EnterConfigurationMode": lambda rig: rig.slave.enterConfigurationMode(),
        "fmi3GetString": lambda rig: rig.slave.getString([0]),
        "fmi3GetOutputDerivatives": lambda rig: rig.slave.getOutputDerivatives([3], [1]),
        "fmi3GetDirectionalDerivative": lambda rig: rig.slave.getDirectionalDerivative([3], [0], [1.0]),
    }
    for function, call in calls.items():
        with moving(drive) as rig:
            with pytest.raises(FMICallException) as error:
                call(rig)
            assert refusal(rig, error).startswith(function)
