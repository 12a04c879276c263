"""Systems in systems: what leads from component to component, and which value counts."""

import sys
from pathlib import Path

import pytest

from tests.kernel.systems.archives import (
    NAMESPACES,
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
from twin.kernel.errors import InputRefused
from twin.kernel.ssp import package
from twin.kernel.ssp import structure as elements
from twin.kernel.ssp.flat import FlatSystem, UnitStep, flatten
from twin.kernel.ssp.package import read_package
from twin.kernel.ssp.structure import (
    Connection,
    Connector,
    Endpoint,
    MappingEntry,
    ParameterBinding,
    ParameterMapping,
    ParameterSet,
    ParameterValue,
    SspComponent,
    SspSystem,
    Structure,
    Transformation,
)


def flat(tmp_path: Path, whole: str) -> FlatSystem:
    return flatten(read_package(archive(tmp_path / "x.ssp", structure(whole), {})).structure, "x.ssp")


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
    into = leads[Endpoint("robot.arm.motor", "u")]
    assert into.start == Endpoint("source", "y")
    assert into.hops == (
        UnitStep(Transformation(2.0, 1.0), True), UnitStep(unit="rpm"), UnitStep(Transformation(3.0)),
    )  # fmt: skip
    assert (
        leads[Endpoint("sink", "u")].start == leads[Endpoint("source", "u")].start == Endpoint("robot.arm.motor", "y")
    )
    assert [hop.unit for hop in leads[Endpoint("sink", "u")].hops] == ["", "deg", ""]


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
        Endpoint("arm.motor", "u"): Endpoint("a", "y"), Endpoint("a", "u"): Endpoint("arm.motor", "y"),
        Endpoint("b", "v"): Endpoint("a", "y"),
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
    assert given["u"].hops == (UnitStep(Transformation(5.0), unit="rpm"), UnitStep(Transformation(3.0)))
    assert given["k"].hops == (UnitStep(),)
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
            "'b', which is not an element of 'system'; it has a",
        ),
        (
            system([component("a", "a.fmu")], [connection("y", "a.u")]),
            "'y', which is not a connector of the system 'system'",
        ),
        (system([inner()], [connection("arm.x", "arm.speed")]), "'x', which is not a connector of the system 'arm'"),
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
    assert [lead.end for lead in flat(tmp_path, ROUND).leads] == [Endpoint("a", "u")]


class Counted(str):
    """A name that counts how often names are compared."""

    __slots__ = ()
    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def wide(n: int) -> SspSystem:
    """`n` connections from the system's own connectors to components, and `n` values that a mapping leads to these."""
    name = Counted
    motors = [SspComponent(name(f"m{k}"), "m.fmu", connectors=(Connector(name("u"), "input"),)) for k in range(n)]
    hub = SspComponent(name("hub"), "h.fmu", connectors=tuple(Connector(name(f"u{k}"), "input") for k in range(n)))
    own = tuple(Connector(name(f"in{k}"), "input") for k in range(2 * n))
    ends = [Endpoint(name(f"m{k}"), name("u")) for k in range(n)] + [
        Endpoint(name("hub"), name(f"u{k}")) for k in range(n)
    ]
    joined = tuple(Connection(Endpoint("", name(f"in{k}")), end) for k, end in enumerate(ends))
    given = ParameterSet("v", tuple(ParameterValue(name(f"v{k}"), "Real", (float(k),)) for k in range(2 * n)))
    led = ParameterMapping(tuple(MappingEntry(name(f"v{k}"), name(f"in{k}")) for k in range(2 * n)))
    return SspSystem("wide", (*motors, hub), joined, own, (ParameterBinding(given, "", led),))


def test_twice_as_many_connectors_and_values_take_twice_as_many_comparisons():
    count = {}
    for n in (100, 200):
        whole = Structure("x", wide(n))
        Counted.compared = 0
        found = flatten(whole, "x.ssp")
        assert found.assigned["hub"][Counted(f"u{n - 1}")].value.values == (2.0 * n - 1.0,)
        assert found.assigned[f"m{n - 1}"]["u"].value.values == (n - 1.0,)
        count[n] = Counted.compared
    # dictionaries compare the few names that fall into one place
    assert 0 < count[200] < 2.5 * count[100]


def test_a_value_gets_to_the_end_of_a_long_way(tmp_path: Path):
    n = sys.getrecursionlimit() + 100
    found = flat(tmp_path, system(
        [component("motor", "m.fmu")],
        [*(connection(f"c{k}", f"c{k + 1}") for k in range(n)), connection(f"c{n}", "motor.u")],
        [connector(f"c{k}", "inout") for k in range(n + 1)],
        values("c0=2.5"),
    ))  # fmt: skip
    assert found.assigned["motor"]["u"].value.values == (2.5,)


def test_what_takes_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = archive(tmp_path / "x.ssp", structure(system([inner()], name="robot")), {})
    read = read_package(file)
    monkeypatch.setattr(elements, "MAX_PARSE_TIME", -1.0)
    with pytest.raises(InputRefused, match=r"^x.ssp: takes more than .* s to read; expected fewer"):
        flatten(read.structure, "x.ssp")
    with pytest.raises(InputRefused, match=r"SystemStructure.ssd: takes more than .* s to read"):
        read_package(file)


def test_a_file_of_values_for_many_components_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    brought: list[str] = []
    content_of = package.read_entry

    def told(file: Path, entry: str, limit: int) -> bytes:
        brought.append(entry)
        return content_of(file, entry, limit)

    monkeypatch.setattr(package, "read_entry", told)
    named = bindings('<ssd:ParameterBinding source="v.ssv"/>')
    set_ = (
        f'<ssv:ParameterSet {NAMESPACES} version="1.0" name="v"><ssv:Parameters><ssv:Parameter name="k">'
        '<ssv:Real value="1.5"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>'
    )
    whole = system([component(f"m{k}", "m.fmu", bindings=named) for k in range(5)])
    found = flatten(read_package(archive(tmp_path / "x.ssp", structure(whole), {"v.ssv": set_})).structure, "x.ssp")
    assert brought.count("v.ssv") == 1
    assert {path: given["k"].value.values for path, given in found.assigned.items()} == dict.fromkeys(
        (f"m{k}" for k in range(5)), (1.5,)
    )
