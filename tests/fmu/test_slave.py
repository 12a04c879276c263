"""The FMI 2.0 ceremony, the same code for every drive: what is refused, and what a state holds."""

from ctypes import byref, c_double, c_int, c_uint

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Error, fmi2LastSuccessfulTime, fmi2ModelExchange

from .rig import DRIVES, MIDDLING, Rig, described, own_names

pytestmark = pytest.mark.parametrize("drive", DRIVES)

BAD_NUMBERS = [float("nan"), float("inf"), float("-inf")]


def refusal(rig: Rig, error: pytest.ExceptionInfo[FMICallException]) -> str:
    """The one message that came with a refused call."""
    assert error.value.status == fmi2Error
    [(status, text)] = rig.messages
    assert status == fmi2Error
    return text


def moving(drive: str) -> Rig:
    """A drive in the middle of something, at 7 ms."""
    rig = Rig(drive).start(command=MIDDLING.get(drive, 0.5), tau_load=0.03)
    rig.run(1e-3, 7)
    return rig


def test_wrong_guid_is_refused(drive: str) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        Rig(drive, guid="{00000000-0000-0000-0000-000000000000}")


def test_model_exchange_is_refused(drive: str) -> None:
    with Rig(drive) as rig:
        guid = described(drive).guid.encode()
        other = rig.slave.fmi2Instantiate(b"x", fmi2ModelExchange, guid, b"", byref(rig.callbacks), 0, 0)
        assert other is None
        assert rig.messages == [(fmi2Error, "this FMU offers co-simulation only")]


def test_a_step_before_initialisation_is_refused(drive: str) -> None:
    with Rig(drive) as rig:
        with pytest.raises(FMICallException) as error:
            rig.step(1e-3)
        assert refusal(rig, error) == "fmi2DoStep is not allowed in mode instantiated"


def test_a_step_after_terminate_is_refused_and_values_stay_readable(drive: str) -> None:
    with moving(drive) as rig:
        theta_m = rig["theta_m"]
        rig.slave.terminate()
        with pytest.raises(FMICallException) as error:
            rig.step(1e-3)
        assert refusal(rig, error) == "fmi2DoStep is not allowed in mode terminated"
        assert rig["theta_m"] == theta_m


@pytest.mark.parametrize("call", ["setupExperiment", "enterInitializationMode", "exitInitializationMode"])
def test_initialisation_out_of_turn_is_refused(drive: str, call: str) -> None:
    with moving(drive) as rig:
        with pytest.raises(FMICallException) as error:
            getattr(rig.slave, call)()
        assert "is not allowed in mode stepping" in refusal(rig, error)


@pytest.mark.parametrize("h", [0.0, -1e-3, *BAD_NUMBERS])
def test_a_step_size_that_is_not_positive_and_finite_is_refused(drive: str, h: float) -> None:
    with moving(drive) as rig:
        before = rig.values()
        with pytest.raises(FMICallException) as error:
            rig.step(h)
        assert "communicationStepSize" in refusal(rig, error)
        assert rig.values() == before


@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_an_input_that_is_not_finite_is_refused_by_name(drive: str, value: float) -> None:
    with moving(drive) as rig:
        before = rig.values()
        with pytest.raises(FMICallException) as error:
            rig["tau_load"] = value
        assert (
            refusal(rig, error)
            == f"fmi2SetReal: {own_names(drive).get('tau_load', 'tau_load')} = {value:g} is not finite"
        )
        assert rig.values() == before


def test_a_refused_value_leaves_its_neighbours_unset_too(drive: str) -> None:
    with moving(drive) as rig:
        with pytest.raises(FMICallException):
            rig.slave.setReal([rig.reference("command"), rig.reference("tau_load")], [1.0, float("nan")])
        assert rig["command"] == MIDDLING.get(drive, 0.5)


def test_a_result_that_is_not_finite_is_an_error(drive: str) -> None:
    with Rig(drive).start(theta_m=1.7e308, command=1.7e308, tau_load=-1.7e308) as rig:
        with pytest.raises(FMICallException) as error:
            rig.run(10.0, 3)
        assert "the result is not finite" in refusal(rig, error)


def test_unknown_value_references_are_refused(drive: str) -> None:
    unknown = len(described(drive).modelVariables)
    for call in (lambda rig: rig.slave.getReal([unknown]), lambda rig: rig.slave.setReal([unknown], [0.0])):
        with Rig(drive).start() as rig:
            with pytest.raises(FMICallException) as error:
                call(rig)
            assert f"unknown value reference {unknown}" in refusal(rig, error)


def test_all_variables_are_real(drive: str) -> None:
    with Rig(drive).start() as rig:
        with pytest.raises(FMICallException) as error:
            rig.slave.getInteger([0])
        assert "all variables of this FMU are Real" in refusal(rig, error)
        assert rig.slave.getBoolean([]) == []


def test_parameters_outside_their_bounds_are_refused(drive: str) -> None:
    for variable in described(drive).modelVariables:
        for bound, outside in ((variable.min, -1.0), (variable.max, 1.0)):
            if bound is None:
                continue
            with Rig(drive) as rig:
                rig[variable.name] = float(bound)
                with pytest.raises(FMICallException) as error:
                    rig[variable.name] = float(bound) + outside
                assert f"{variable.name} = " in refusal(rig, error)
                assert rig[variable.name] == float(bound)


def test_only_inputs_can_be_set_once_the_drive_runs(drive: str) -> None:
    for variable in described(drive).modelVariables:
        with moving(drive) as rig:
            if variable.causality == "input":
                rig[variable.name] = 0.0
                continue
            with pytest.raises(FMICallException) as error:
                rig[variable.name] = float(variable.start)
            assert "can only be set before the first step" in refusal(rig, error)


def test_start_values_are_those_of_the_description(drive: str) -> None:
    with Rig(drive) as rig:
        assert rig.values() == [float(v.start) for v in described(drive).modelVariables]


def test_reset_gives_a_new_drive(drive: str) -> None:
    with Rig(drive) as fresh, moving(drive) as rig:
        rig.slave.reset()
        assert rig.values() == fresh.values()
        rig.time = 0.0
        for instance in (fresh, rig):
            instance.start(command=-MIDDLING.get(drive, 0.5)).run(1e-3, 10)
        assert rig.values() == fresh.values()


def test_a_restored_state_repeats_the_future_bit_for_bit(drive: str) -> None:
    with moving(drive) as rig:
        state = rig.slave.getFMUstate()
        rig.run(0.7e-3, 10)
        first = rig.values()
        rig["command"] = 6 * MIDDLING.get(drive, 0.5)
        rig.step(1e-3)
        rig.slave.setFMUstate(state)
        rig.time = 7e-3
        rig.run(0.7e-3, 10)
        assert rig.values() == first
        rig.slave.freeFMUstate(state)
        assert state.value is None


def test_a_serialised_state_moves_to_another_instance(drive: str) -> None:
    with moving(drive) as rig, Rig(drive) as other:
        state = rig.slave.getFMUstate()
        copy = other.slave.deSerializeFMUstate(rig.slave.serializeFMUstate(state))
        other.slave.setFMUstate(copy)
        other.time = rig.time
        for instance in (rig, other):
            instance.run(1e-3, 5)
        assert other.values() == rig.values()
        rig.slave.freeFMUstate(state)
        other.slave.freeFMUstate(copy)


def test_a_truncated_serialised_state_is_refused(drive: str) -> None:
    with moving(drive) as rig:
        state = rig.slave.getFMUstate()
        with pytest.raises(FMICallException) as error:
            rig.slave.deSerializeFMUstate(rig.slave.serializeFMUstate(state)[:-1])
        assert "a state has" in refusal(rig, error)
        rig.slave.freeFMUstate(state)


def test_last_successful_time_is_the_end_of_the_last_step(drive: str) -> None:
    with moving(drive) as rig:
        value = c_double()
        rig.slave.fmi2GetRealStatus(rig.slave.component, fmi2LastSuccessfulTime, byref(value))
        assert value.value == rig.time


def test_what_the_description_does_not_offer_is_refused(drive: str) -> None:
    reference, order, value = c_uint(0), c_int(1), c_double(0.0)
    with moving(drive) as rig:
        arguments = (rig.slave.component, byref(reference), 1, byref(order), byref(value))
        for function in ("fmi2SetRealInputDerivatives", "fmi2GetRealOutputDerivatives"):
            rig.messages.clear()
            with pytest.raises(FMICallException) as error:
                getattr(rig.slave, function)(*arguments)
            assert refusal(rig, error).startswith(function)
