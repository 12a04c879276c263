"""Systems run as their structure says: order, units, values, systems in systems, versions of FMI."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.first import first_description, first_drive, first_library
from tests.kernel.fmi.three_axes import three_axes_drive
from tests.kernel.systems.archives import archive, component, connection, connector, line, structure, system, values
from tests.kernel.systems.conftest import Ran
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system
from twin.studies.systems.recorded import system_result

A = component("a", "a.fmu", bindings=values("omega_ref=1"))
B = component("b", "a.fmu")
WIRE = connection("a.omega_m", "b.omega_ref")


def first_move(speed: np.ndarray) -> int:
    return int(np.flatnonzero(speed)[0])


def test_gauss_seidel_hands_on_at_once_in_the_order_of_the_file_and_jacobi_a_step_later(ran: Ran):
    forward, backward = structure(system([A, B], [WIRE]), 0.01), structure(system([B, A], [WIRE]), 0.01)
    for ssd, scheme, row, late in (
        (forward, "gauss_seidel", 1, 0),
        (backward, "gauss_seidel", 2, 1),
        (forward, "jacobi", 2, 1),
        (backward, "jacobi", 2, 1),
    ):
        run, facts = ran(ssd, scheme=scheme)
        assert first_move(run["a.omega_m"]) == 1 and first_move(run["b.omega_m"]) == row
        assert len(facts["late"]) == late and len(run.time("b")) == 11
        assert json.loads(run.metadata["system"]["order"]) == (["a", "b"] if ssd == forward else ["b", "a"])


def test_units_are_converted_and_then_the_line_is_applied(ran: Ran, ideal: Path, tmp_path: Path):
    speed, rest = 'start="0.0" unit="rad/s" />', '\n    </ScalarVariable>\n    <ScalarVariable name="tau_load"'
    rpm = redescribed(ideal, tmp_path / "rpm.fmu", speed + rest, speed.replace("rad/s", "rpm") + rest)
    for inside, more, expected in (
        ("", "", 30 / math.pi),
        (line(-2.0, 3.0), "", 3.0 - 60 / math.pi),
        (line(-2.0, 3.0), 'suppressUnitConversion="true"', 1.0),
        ("", 'suppressUnitConversion="true"', 1.0),
    ):
        wire = connection("a.omega_m", "b.omega_ref", inside, more)
        run, _ = ran(structure(system([A, component("b", "rpm.fmu")], [wire]), 0.003), {"rpm.fmu": rpm})
        assert run["b.omega_m"][-1] == pytest.approx(expected, rel=1e-15)


def test_a_wire_without_units_to_convert_changes_no_bit(ran: Ran):
    given = -1.0 / 3.0
    first = component("a", "a.fmu", bindings=values(f"omega_ref={given!r}"))
    run, _ = ran(structure(system([first, B], [WIRE]), 0.003))
    assert run["b.omega_m"][-1] == given
    zero, _ = ran(structure(system([component("a", "a.fmu", bindings=values("omega_ref=-0.0")), B], [WIRE]), 0.003))
    assert math.copysign(1.0, zero["b.omega_m"][-1]) == -1.0


def test_systems_in_systems_are_run_as_if_there_were_none(ran: Ran):
    inner = system(
        [component("shaft", "a.fmu")],
        [connection("speed", "shaft.omega_ref"), connection("shaft.omega_m", "turned")],
        [connector("speed", "input", "rpm"), connector("turned", "output")],
        name="joint",
    )
    wires = [connection("a.omega_m", "joint.speed"), connection("joint.turned", "b.omega_ref")]
    run, facts = ran(structure(system([A, inner, B], wires), 0.005))
    assert list(facts["components"]) == ["a", "joint.shaft", "b"]
    # to rpm and back again
    assert run["joint/shaft.omega_m"][-1] == pytest.approx(1.0, rel=1e-15)
    assert run["b.omega_m"][-1] == run["joint/shaft.omega_m"][-1]


def test_values_are_set_in_the_units_of_the_fmu_and_those_of_nobody_are_told(ran: Ran):
    bound = values("a.omega_ref=60 rpm", "a.theta_m=90 deg", "c.x=1", "a.x=1")
    run, facts = ran(structure(system([component("a", "a.fmu")], bindings=bound), 1.0), tick=0.01)
    assert run["a.theta_m"][0] == pytest.approx(math.pi / 2, rel=1e-15)
    assert run["a.omega_m"][-1] == pytest.approx(2 * math.pi, rel=1e-15)
    assert sorted(facts["ignored"]) == ["a.x", "c.x"]
    assert facts["kept"] == facts["not_fed"] == {"a.omega_ref": pytest.approx(2 * math.pi), "a.tau_load": 0.0}
    assert "ignored    values that get to no variable: c.x, a.x" in system_result(facts).text


def test_all_versions_of_fmi_run_together(ran: Ran, root: Path, tmp_path: Path):
    resources = {
        "1.fmu": first_drive(first_library(root, tmp_path), tmp_path / "1.fmu", first_description()),
        "3.fmu": three_axes_drive(root, tmp_path),
    }
    parts = [
        component("one", "1.fmu", bindings=values("omega_ref=2")),
        component("axes", "3.fmu"), component("more", "3.fmu"), B,
    ]  # fmt: skip
    wires = [connection("one.omega_m", "b.omega_ref"), connection("axes.theta_m", "more.tau_load")]
    bound = values("axes.omega_ref=1")
    with pytest.raises(InputRefused, match=r"axes\.theta_m to more\.tau_load: from 'rad' to 'N\.m'"):
        ran(structure(system(parts, wires), 0.01), resources)
    wires[1] = connection("axes.omega_m", "more.omega_ref")
    run, facts = ran(structure(system(parts, wires, bindings=bound), 0.1), resources)
    assert run["more.theta_m"].shape == (101, 3) and run["axes.omega_m"][-1, 0] > 0.0
    assert run["b.omega_m"][-1] == run["one.omega_m"][-1] != 0.0
    assert [one["fmi"] for one in facts["components"].values()] == ["1.0", "3.0", "3.0", "2.0"]
    assert run.fields()["axes.theta_m"].unit == "rad"


def test_a_component_may_have_no_outputs_and_then_has_no_topic(ran: Ran, ideal: Path, tmp_path: Path):
    sink = redescribed(ideal, tmp_path / "sink.fmu", 'causality="output"', 'causality="local"')
    whole = system([A, component("sink", "sink.fmu")], [connection("a.omega_m", "sink.omega_ref")])
    run, facts = ran(structure(whole, 0.01), {"sink.fmu": sink})
    assert list(run.streams) == ["a"] and list(facts["components"]) == ["a", "sink"]
    with pytest.raises(InputRefused, match="no FMU has an output that is a number"):
        ran(structure(system([component("sink", "sink.fmu")]), 0.01), {"sink.fmu": sink})


def test_names_that_no_topic_can_have_are_others_or_refused(ran: Ran):
    names = ("events", "a b", "a-b", "1", "\u03b8")
    run, facts = ran(structure(system([component(name, "a.fmu") for name in names]), 0.002))
    assert list(run.streams) == ["events_2", "a_b", "a_b_2", "x_1", "x"]
    assert {path: one["topic"] for path, one in facts["components"].items()} == dict(
        zip(names, run.streams, strict=True)
    )


def test_values_at_the_start_go_from_one_fmu_to_the_next_before_the_first_step(tmp_path: Path, ideal: Path):
    wires = [connection("b.theta_m", "a.tau_load", more='suppressUnitConversion="true"')]
    whole = system([component("a", "a.fmu"), component("b", "a.fmu", bindings=values("theta_m=0.25"))], wires)
    package = read_package(archive(tmp_path / "x.ssp", structure(whole, 0.01), {"a.fmu": ideal}))
    with open_system(package, MasterChoice(scheme="jacobi")) as (plan, made):
        first = made.system.components[0]
        assert isinstance(first, FmuComponent) and made.settled
        assert first.instance.read_floats([plan.parts[0].inputs[0].variable]) == [0.25]


def test_the_step_is_that_of_an_annotation_or_else_the_shortest_that_an_fmu_wants(ran: Ran):
    master = (
        '<ssd:Annotations><ssc:Annotation type="org.openmodelica"><o:Annotations xmlns:o="o"><o:SimulationInformation>'
        '<o:FixedStepMaster description="oms-ma" stepSize="0.0025"/></o:SimulationInformation></o:Annotations>'
        "</ssc:Annotation></ssd:Annotations>"
    )
    whole = system([A])
    for ssd, asked, tick, told in (
        (structure(whole, 0.01), {}, 0.001, "what the FMU of a wants"),
        (structure(whole, 0.01, notes=master), {}, 0.0025, "an annotation of the structure (org.openmodelica)"),
        (structure(whole, 0.01, notes=master), {"tick": 0.002}, 0.002, "--tick-ms"),
        (structure(whole, notes=master), {"stop": 0.005}, 0.0025, "an annotation of the structure (org.openmodelica)"),
    ):
        run, facts = ran(ssd, **asked)
        assert (facts["tick_s"], facts["tick_from"]) == (tick, told)
        assert run.time("a")[1] == tick and run.time("a")[-1] == asked.get("stop", 0.01)


def test_a_system_goes_on_from_a_state_of_its_run(ran: Ran, tmp_path: Path):
    ssd = structure(system([A, B], [WIRE]), 0.01)
    whole, _ = ran(ssd, stop=0.5, state_every=0.1)
    part, _ = ran(ssd, stop=0.5, start_from=f"{tmp_path / 'run_1'}@0.25")
    assert part.note == "" and part.metadata["continues"] == {"run": "run_1", "time_s": "0.2"}
    for key in whole.fields():
        np.testing.assert_array_equal(whole[key][-len(part[key]) :], part[key])
    assert part.time("a")[0] == pytest.approx(0.2)
    with pytest.raises(InputRefused, match=r"the state at 0\.2 s is of another experiment"):
        ran(ssd, stop=0.5, scheme="jacobi", start_from=f"{tmp_path / 'run_1'}@0.25")
    with pytest.raises(InputRefused, match=r"has no state at 0\.05 s or before"):
        ran(ssd, stop=0.5, start_from=f"{tmp_path / 'run_1'}@0.05")
