"""Regular ends that an FMU asks for, and small offences that are let through only where that is asked for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.systems.archives import bindings, component, connection, connector, structure, system
from tests.kernel.systems.conftest import Ran
from tests.kernel.systems.linear import Linear
from twin.kernel.errors import InputRefused
from twin.studies.reference.outcome import Trial, outcome_of
from twin.studies.systems.recorded import system_result

RAMP: dict[str, Any] = {"a": [[0, 1], [0, 0]], "c": [[1]], "x0": [0, 1]}
ENDS = Linear(**RAMP, ends_at=0.5)
PARTS = [component("a", "r.fmu"), component("b", "r.fmu")]
ASKED: list[dict[str, Any]] = [
    {},
    {"kinds": {"": "model_exchange"}},
    {"loops": "solve"},
]


@pytest.mark.parametrize("asked", ASKED, ids=["cs", "me", "loops"])
def test_an_fmu_that_asks_for_the_end_ends_the_run_regularly_with_a_whole_recording(
    ran: Ran, tmp_path: Path, asked: dict[str, Any]
):
    run, facts = ran(structure(system(PARTS), 1.0), {"r.fmu": ENDS.fmu(tmp_path / "r.fmu")}, **asked)
    # the last row is the last that the FMU came to
    assert run.time("a")[-1] == pytest.approx(0.5, abs=0.011) and run["a.y"][-1] == pytest.approx(run.time("a")[-1])
    assert "r.fmu (a) " in facts["ended"] and "asked to terminate the simulation" in facts["ended"]
    assert facts["simulated_s"] == run.time("a")[-1]
    assert "end        regular, before its time: r.fmu (a)" in " ".join(
        line for line in system_result(facts).text.splitlines() if "regular" in line
    )
    assert (facts["events"][-1]["level"], facts["events"][-1]["source"]) == ("INFO", "a")


def test_a_loop_whose_member_asks_for_the_end_ends_as_regularly(ran: Ran, tmp_path: Path):
    parts = {"a": Linear(c=[[1]], d=[[0.5]], a=[[0]], x0=[1], ends_at=0.1), "b": Linear(d=[[0.5]])}
    resources = {f"{name}.fmu": part.fmu(tmp_path / f"{name}.fmu") for name, part in parts.items()}
    whole = system(
        [component(name, f"{name}.fmu") for name in parts], [connection("a.y", "b.u"), connection("b.y", "a.u")]
    )
    run, facts = ran(structure(whole, 1.0), resources, loops="solve")
    assert run.time("a")[-1] == pytest.approx(0.1, abs=0.011) and "asked to terminate" in facts["ended"]


def test_the_verdict_of_the_survey_is_the_same(tmp_path: Path):
    file = Linear(**RAMP, ends_at=0.5, experiment='stopTime="1" stepSize="0.01"').fmu(tmp_path / "r.fmu")
    outcome = outcome_of(file, Trial("default experiment"))
    assert outcome.word == "ran" and "then, regularly: r.fmu (fmu)" in outcome.detail


def test_a_binary_without_a_function_that_is_never_called_runs_where_that_is_let_through(ran: Ran, tmp_path: Path):
    resources = {"r.fmu": Linear(**RAMP, lacking=True).fmu(tmp_path / "r.fmu")}
    with pytest.raises(InputRefused, match=r"its binary does not load: .*fmi2CancelStep"):
        ran(structure(system(PARTS), 0.1), resources)
    run, facts = ran(structure(system(PARTS), 0.1), resources, lenient=True)
    assert facts["forgiven"] == ["a lacks fmi2CancelStep", "b lacks fmi2CancelStep"]
    assert run.metadata["system"]["forgiven"] == '["a lacks fmi2CancelStep", "b lacks fmi2CancelStep"]'
    assert "forgiven   a lacks fmi2CancelStep" in system_result(facts).text
    assert run["a.y"][-1] == pytest.approx(0.1)
    # nothing that was forgiven stays so
    with pytest.raises(InputRefused, match="fmi2CancelStep"):
        ran(structure(system(PARTS), 0.1), resources)


def test_units_in_brackets_are_those_inside(ran: Ran, ideal: Path, tmp_path: Path):
    speed, rest = 'start="0.0" unit="rad/s" />', '\n    </ScalarVariable>\n    <ScalarVariable name="tau_load"'
    resources = {"s.fmu": redescribed(ideal, tmp_path / "s.fmu", speed + rest, speed.replace("rad/s", "[rpm]") + rest)}
    first = component("a", "a.fmu", [connector("omega_m", "output", "[rad/s]")], bindings=one("omega_ref", "1"))
    whole = structure(system([first, component("b", "s.fmu")], [connection("a.omega_m", "b.omega_ref")]), 0.003)
    with pytest.raises(InputRefused, match=r"\[rad/s\]"):
        ran(whole, resources)
    run, facts = ran(whole, resources, lenient=True)
    assert run["b.omega_m"][-1] == pytest.approx(30.0 / np.pi, rel=1e-12)
    assert [text.rpartition(": ")[2] for text in facts["forgiven"]] == [
        "the unit '[rpm]' taken as 'rpm'", "the unit '[rad/s]' taken as 'rad/s'",
    ]  # fmt: skip


def one(name: str, value: str, type_: str = "Real") -> str:
    return bindings(
        '<ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="v"><ssv:Parameters>'
        f'<ssv:Parameter name="{name}"><ssv:{type_} value="{value}"/></ssv:Parameter></ssv:Parameters>'
        "</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>"
    )


def test_an_item_of_an_enumeration_may_be_given_by_its_number(ran: Ran, tmp_path: Path):
    resources = {"r.fmu": Linear(**RAMP, modes=True).fmu(tmp_path / "r.fmu")}

    def moded(value: str) -> str:
        return structure(system([component("a", "r.fmu", bindings=one("mode", value, "Enumeration"))]), 0.1)

    with pytest.raises(InputRefused, match=r"mode = '2': expected one of slow \(1\), fast \(2\)"):
        ran(moded("2"), resources)
    # the FMU refuses every other one
    _, facts = ran(moded("2"), resources, lenient=True)
    assert facts["forgiven"] == [f"{tmp_path / '2.ssp'}: a.mode: an item of an enumeration by its number, 2"]
    ran(moded("fast"), resources)
    for value, told in (("3", "mode = 3: expected one of slow"), ("quick", "mode = 'quick': expected one of slow")):
        with pytest.raises(InputRefused, match=told):
            ran(moded(value), resources, lenient=True)
