"""Systems in systems: what leads from component to component, and which value counts."""

from pathlib import Path

import pytest

from tests.studies.systems.archives import (
    archive,
    bindings,
    component,
    connection,
    connector,
    line,
    structure,
    system,
    values,
)
from twin.cosim.ssp.flat import FlatSystem, Hop, flattened
from twin.cosim.ssp.package import read_package
from twin.cosim.ssp.structure import End
from twin.cosim.ssp.unit import Transformation
from twin.errors import InputRefused


def flat(tmp_path: Path, whole: str) -> FlatSystem:
    return flattened(read_package(archive(tmp_path / "x.ssp", structure(whole), {})).structure, "x.ssp")


def inner(*bound: str, connections: tuple[str, ...] = (), name: str = "arm") -> str:
    """A system with a motor inside, which `speed` leads into and `angle` out of."""
    return system(
        [component("motor", "m.fmu", bindings="".join(bound))],
        [connection("speed", "motor.u", line(3.0)), connection("motor.y", "angle"), *connections],
        [connector("speed", "input", "rpm"), connector("angle", "output")],
        name=name,
    )


def test_connections_through_systems_lead_from_component_to_component(tmp_path: Path):
    deep = system(
        [inner()],
        [connection("in", "arm.speed"), connection("arm.angle", "out")],
        [connector("in", "input"), connector("out", "output", "deg")],
        name="robot",
    )
    found = flat(tmp_path, system(
        [component("source", "s.fmu"), deep, component("sink", "t.fmu")],
        [
            connection("source.y", "robot.in", line(2.0, 1.0), 'suppressUnitConversion="true"'),
            connection("robot.out", "sink.u"), connection("robot.out", "source.u"),
        ],
    ))  # fmt: skip
    assert list(found.components) == ["source", "robot.arm.motor", "sink"]
    leads = {lead.end: lead for lead in found.leads}
    into = leads[End("robot.arm.motor", "u")]
    assert into.start == End("source", "y")
    assert into.hops == (
        Hop(Transformation(2.0, 1.0), True), Hop(unit="rpm"), Hop(Transformation(3.0)),
    )  # fmt: skip
    assert leads[End("sink", "u")].start == leads[End("source", "u")].start == End("robot.arm.motor", "y")
    assert [hop.unit for hop in leads[End("sink", "u")].hops] == ["", "deg", ""]


def test_the_kinds_of_connectors_say_which_way_a_value_goes_and_not_start_and_end(tmp_path: Path):
    ends = [connector("y", "output"), connector("u", "input")]
    arm = system(
        [component("motor", "m.fmu", ends)],
        [connection("motor.u", "speed", line(3.0)), connection("angle", "motor.y")],
        [connector("speed", "input"), connector("angle", "output")],
        name="arm",
    )
    wires = [connection("arm.speed", "a.y"), connection("a.u", "arm.angle"), connection("b.v", "a.y")]
    found = flat(tmp_path, system([arm, component("a", "a.fmu", ends), component("b", "a.fmu")], wires))
    assert {lead.end: lead.start for lead in found.leads} == {
        End("arm.motor", "u"): End("a", "y"), End("a", "u"): End("arm.motor", "y"), End("b", "v"): End("a", "y"),
    }  # fmt: skip
    with pytest.raises(InputRefused, match=r"a\.y and arm\.angle, which both give values"):
        flat(tmp_path, system([arm, component("a", "a.fmu", ends)], [connection("a.y", "arm.angle")]))


def test_an_input_of_the_outermost_system_is_fed_by_nobody(tmp_path: Path):
    found = flat(tmp_path, system(
        [component("a", "a.fmu")], [connection("u", "a.u"), connection("a.y", "y")],
        [connector("u", "input"), connector("y", "output")],
    ))  # fmt: skip
    assert found.leads == ()


def test_values_of_a_higher_level_and_later_ones_count(tmp_path: Path):
    own = values("k=1", "j=1", "i=1")
    found = flat(tmp_path, system(
        [inner(own)], bindings=bindings(*[
            one.removeprefix("<ssd:ParameterBindings>").removesuffix("</ssd:ParameterBindings>") for one in (
                values("arm.motor.k=2", "arm.motor.j=2"), values("motor.j=3", "nothing=1", prefix="arm."),
            )
        ]),
    ))  # fmt: skip
    given = found.assigned["arm.motor"]
    assert {name: one.value.values for name, one in given.items()} == {"k": (2.0,), "j": (3.0,), "i": (1.0,)}
    assert found.ignored == ("arm.nothing",)


def test_a_mapping_and_connectors_lead_values_to_variables(tmp_path: Path):
    entries = (
        '<ssm:MappingEntry source="p.a" target="arm.speed"><ssc:LinearTransformation factor="5"/></ssm:MappingEntry>'
    )
    entries += '<ssm:MappingEntry source="p.a" target="arm.motor.k"/>'
    found = flat(tmp_path, system([inner()], bindings=values("a=1", "arm.motor.j=4", prefix="p.", mapping=entries)))
    given = found.assigned["arm.motor"]
    assert given["u"].hops == (Hop(Transformation(5.0), unit="rpm"), Hop(Transformation(3.0)))
    assert given["k"].hops == (Hop(),)
    # with its prefix it is called otherwise
    assert set(given) == {"u", "k"} and found.ignored == ("p.arm.motor.j",)


ROUND = system(
    [system([], [connection("in", "out")], [connector("in", "input"), connector("out", "output")], name="pipe"),
     component("a", "a.fmu")],
    [connection("pipe.out", "pipe.in"), connection("a.y", "a.u")],
)  # fmt: skip
FED = system(
    [system([], [connection("in", "out")], [connector("in", "input"), connector("out", "output")], name="pipe"),
     system([component("a", "a.fmu")], [connection("u", "a.u")], [connector("u", "input")], name="s")],
    [connection("pipe.out", "pipe.in"), connection("pipe.out", "s.u")],
)  # fmt: skip


@pytest.mark.parametrize(
    ("whole", "told"),
    [
        (FED, "x.ssp: what feeds s.a.u leads in a circle through pipe.out, a connector of a system"),
        (
            system([component(name, "a.fmu") for name in "abc"], [connection(f"{name}.y", "c.u") for name in "ab"]),
            "x.ssp: c.u is fed by two connections, from a.y and from b.y; remove one",
        ),
        (
            system([component("a", "a.fmu")], [connection("b.y", "a.u")]),
            "'b', which is no element of 'system'; it has a",
        ),
        (
            system([component("a", "a.fmu")], [connection("y", "a.u")]),
            "'y', which is no connector of the system 'system'",
        ),
        (system([inner()], [connection("arm.x", "arm.speed")]), "'x', which is no connector of the system 'arm'"),
        (
            system([component("arm.motor", "a.fmu"), inner()]),
            "two elements have the path 'arm.motor'",
        ),
    ],
)
def test_what_leads_nowhere_twice_or_in_a_circle_is_refused(tmp_path: Path, whole: str, told: str):
    with pytest.raises(InputRefused) as refused:
        flat(tmp_path, whole)
    assert told in str(refused.value)


def test_a_circle_that_feeds_no_component_feeds_nobody(tmp_path: Path):
    assert [lead.end for lead in flat(tmp_path, ROUND).leads] == [End("a", "u")]
