"""Parameter files: what is in them is read, what is no value is refused.

What is written is a file of the standard, and is read back as what it was.
"""

import zipfile
from pathlib import Path

import fmpy.ssp
import pytest
from lxml import etree

from tests.kernel.systems.archives import (
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
from tests.studies.reference.test_carried import real, ssv
from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_xml
from twin.kernel.ssp import package as package_module
from twin.kernel.ssp.package import read_package
from twin.kernel.ssp.ssd import (
    Resource,
    mapping_of,
    parameter_set,
    parameter_set_xml,
    structure_of,
    structure_xml,
)
from twin.kernel.ssp.structure import (
    Annotation,
    Connection,
    Connector,
    DefaultExperiment,
    Endpoint,
    MappingEntry,
    Metadata,
    ParameterBinding,
    ParameterMapping,
    ParameterSet,
    ParameterValue,
    SspComponent,
    SspSystem,
    Structure,
    Transformation,
    UnitDefinition,
)
from twin.kernel.units import Dimension

SSV = (
    '<v:ParameterSet xmlns:v="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="p">'
    '<v:Parameters><v:Parameter name="k"><v:Real value="2"/></v:Parameter></v:Parameters></v:ParameterSet>'
)
SSM = (
    '<m:ParameterMapping xmlns:m="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" version="1.0">'
    '<m:MappingEntry source="k" target="droop"/></m:ParameterMapping>'
)
ONE = component("a", "a.fmu")


def outside(source: str = "sub/p.ssv", mapping: str = "../m.ssm", more: str = "") -> str:
    return bindings(
        f'<ssd:ParameterBinding source="{source}" {more}><ssd:ParameterMapping source="{mapping}"/>'
        "</ssd:ParameterBinding>"
    )


def test_all_that_a_structure_says_is_read(tmp_path: Path):
    note = '<ssc:Annotation type="org.x"><oms:Step xmlns:oms="o" size="1"/></ssc:Annotation>'
    parts = [
        component(
            "a", "resources/a%20b.fmu", [connector("u", "input", "rad/s"), connector("n", "output", type_="Integer")],
            values("k=2.5 mm", "j=1", prefix="p."), 'implementation="CoSimulation"',
        ),
        system([component("inner", "b.fmu")], [connection("inner.y", "out")], [connector("out", "output")], name="sub"),
    ]  # fmt: skip
    wires = [
        connection("a.n", "sub.x"),
        connection("sub.out", "a.u", line(2.0, -1.0), 'suppressUnitConversion="true"'),
    ]
    unit = '<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>'
    file = archive(
        tmp_path / "x.ssp",
        structure(system(parts, wires), 2.5, unit, notes=f"<ssd:Annotations>{note}</ssd:Annotations>"),
        {"resources/a b.fmu": "fmu"},
    )
    package = read_package(file)
    found = package.structure
    a, sub = found.system.elements
    assert isinstance(a, SspComponent) and isinstance(sub, SspSystem)
    assert a.connectors == (Connector("u", "input", "Real", "rad/s"), Connector("n", "output", "Integer"))
    assert a.implementation == "CoSimulation" and package.entry(a.source) == "resources/a b.fmu"
    assert package.content("resources/a b.fmu") == b"fmu"
    (binding,) = a.bindings
    assert (binding.prefix, binding.mapping) == ("p.", None)
    assert [(one.name, one.values, one.unit) for one in binding.parameters.parameters] == [
        ("k", (2.5,), "mm"), ("j", (1.0,), ""),
    ]  # fmt: skip
    assert sub.connections == (Connection(Endpoint("inner", "y"), Endpoint("", "out")),)
    assert found.system.connections[1] == Connection(
        Endpoint("sub", "out"), Endpoint("a", "u"), Transformation(2.0, -1.0), True
    )
    assert found.units == (UnitDefinition("mm", Dimension(m=1), 0.001),)
    assert (found.experiment.start, found.experiment.stop, found.version) == (0.0, 2.5, "1.0")
    assert found.annotations[0].type == "org.x" and 'size="1"' in found.annotations[0].content


def test_parameters_may_stand_in_files_of_the_archive(tmp_path: Path):
    whole = system([component("a", "a.fmu", bindings=outside("sub/p.ssv", "m.ssm"))])
    file = archive(tmp_path / "x.ssp", structure(whole, version="2.0"), {"sub/p.ssv": SSV, "m.ssm": SSM})
    (part,) = read_package(file).structure.system.elements
    (binding,) = part.bindings
    assert binding.parameters.source == "sub/p.ssv" and binding.parameters.parameters[0].values == (2.0,)
    assert binding.mapping is not None and binding.mapping.entries[0].target == "droop"


DEEP = "".join(f'<ssd:System name="s{i}"><ssd:Elements>' for i in range(20)) + "</ssd:Elements></ssd:System>" * 20
BAD = {
    "entities": (structure(system([ONE]), head='<!DOCTYPE x [<!ENTITY a "b">]>'), "it has a document type (DOCTYPE)"),
    "no XML": ("<x", "not valid XML"),
    "another standard": (structure(system([ONE])).replace("/SSP1/SystemStructureD", "/d"), "of SSP 1.0 or 2.0"),
    "another version": (structure(system([ONE]), version="3.0"), "version '3.0'; expected 1.0 or 2.0"),
    "no system": (structure(""), "has no system"),
    "too deep": (structure(DEEP), "nested too deeply"),
    "dictionaries": (
        structure(system([ONE]).replace("</ssd:System>", "<ssd:SignalDictionaries/></ssd:System>")),
        "system 'system' has signal dictionaries, which are not supported",
    ),
    "a dictionary": (
        structure(system([ONE, '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'])),
        "element 'bus' is a signal dictionary reference, which is not supported",
    ),
    "names twice": (structure(system([ONE, ONE])), "two elements of system 'system' are called 'a'"),
    "connectors twice": (
        structure(system([component("a", "a.fmu", [connector("u", "input")] * 2)])),
        "two connectors of 'a' are called 'u'",
    ),
    "no name": (structure(system([component("", "a.fmu")])), "a <Component> without name"),
    "no kind": (structure(system([component("a", "a.fmu", [connector("u", "put")])])), "a.u: kind 'put'; expected"),
    "elements of arrays": (
        structure(system([ONE], [connection("a.y", "a.u", more='startIndices="1"')])),
        "the connection from a.y to a.u selects elements of arrays",
    ),
    "a factor": (structure(system([ONE], [connection("a.y", "a.u", line("NaN"))])), "factor = 'NaN'; expected"),
    "a unit": (structure(system([ONE]), units='<ssc:Unit name="N"/>'), "unit 'N' without a BaseUnit"),
    "a unit of nothing": (
        structure(system([ONE]), units='<ssc:Unit name="N"><ssc:BaseUnit factor="0"/></ssc:Unit>'),
        "unit 'N' has the factor 0",
    ),
    "a missing file": (
        structure(system([component("a", "a.fmu", bindings=outside("p.ssv"))])),
        "parameters of 'a': 'p.ssv' is not a file of this archive",
    ),
    "a file outside": (
        structure(system([component("a", "a.fmu", bindings=outside("../../etc/passwd"))])),
        "'../../etc/passwd' is not a file of this archive",
    ),
    "a file inside the FMU": (
        structure(system([component("a", "a.fmu", bindings=outside(more='sourceBase="component"'))])),
        "lies in the component itself",
    ),
    "other parameters": (
        structure(system([component("a", "a.fmu", bindings=outside(more='type="text/csv"'))])),
        "are of type 'text/csv'; expected application/x-ssp-parameter-set",
    ),
    "no parameters": (
        structure(system([component("a", "a.fmu", bindings=bindings("<ssd:ParameterBinding/>"))])),
        "neither a source nor values",
    ),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
def test_a_structure_that_cannot_be_read_is_refused_with_what_is_wrong(tmp_path: Path, bad: str):
    ssd, told = BAD[bad]
    with pytest.raises(InputRefused) as refused:
        read_package(archive(tmp_path / "x.ssp", ssd, {}))
    assert str(refused.value).startswith(f"{tmp_path / 'x.ssp'}: SystemStructure.ssd: ") or "not a file" in str(
        refused.value
    )
    assert told in str(refused.value)


def test_an_archive_that_is_none_or_leads_outside_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "text.ssp").write_text("x")
    archive(tmp_path / "out.ssp", structure(system([ONE])), {"../../evil.fmu": "x"})
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as empty:
        empty.writestr("a.fmu", "x")
    for name, told in (
        ("none.ssp", "no such SSP"),
        ("text.ssp", "not a complete SSP"),
        ("out.ssp", "entry '../../evil.fmu' points outside the archive"),
        ("empty.ssp", "no SystemStructure.ssd inside; this is not an SSP"),
    ):
        with pytest.raises(InputRefused, match=f"{name}: {told}"):
            read_package(tmp_path / name)
    monkeypatch.setattr(package_module, "MAX_STRUCTURE_SIZE", 1 << 10)
    large = archive(tmp_path / "large.ssp", structure(system([ONE])) + " " * 1024, {})
    with pytest.raises(InputRefused, match=r"SystemStructure\.ssd: 0 MB; expected at most"):
        read_package(large)


def test_whole_numbers_and_truth_values_are_numbers():
    given = [
        'name="a"><ssv:Integer value="-3"/>',
        'name="b"><ssv:Boolean value="true"/>',
        'name="c"><ssv:UInt8 value="7"/>',
    ]
    assert [one.values for one in parameter_set(ssv(*given), "x").parameters] == [(-3.0,), (1.0,), (7.0,)]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (ssv(real("a", "1"), real("a", "2")), "given twice, a"),
        (ssv(real("", "1")), "without a name"),
        (ssv('name="a">'), "without one value, a"),
        (ssv(real("a", "NaN")), "a: Real 'NaN'; expected finite numbers"),
        (ssv(real("a", "1e999")), "a: Real '1e999'"),
        (ssv(real("a", "1 x 3")), "a: Real 'x'"),
        (ssv('name="a"><ssv:Integer value="1.5"/>'), "a: Integer '1.5'"),
        (ssv(f'name="a"><ssv:Integer value="{"9" * 400}"/>'), "a: Integer '999"),
        (ssv('name="a"><ssv:Boolean value="yes"/>'), "a: Boolean 'yes'"),
        (ssv('name="a"><ssv:Quaternion value="1"/>'), "a: Quaternion '1'"),
        (ssv(*[real(str(n), "1") for n in range(3)]), "3 parameters; expected at most 2"),
        (b"<other/>", "expected <ParameterSet>"),
    ],
)
def test_what_is_no_number_or_text_is_refused(content: bytes, told: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("twin.kernel.ssp.ssd.MAX_PARAMETERS", 2)
    with pytest.raises(InputRefused, match="x: ") as refused:
        parameter_set(content, "x")
    assert told in str(refused.value)


def test_arrays_and_texts_are_read_as_the_standard_writes_them():
    given = [
        real("a", "1 2.5e0\n -3", "mm"),
        'name="b" description="why"><ssv:String value="file:x 1"/>',
        'name="c"><ssv:Enumeration value="on"/>',
        'name="d"><ssv:String><ssv:Value value="x"/><ssv:Value value="y"/></ssv:String><ssv:Dimension size="2"/>',
    ]
    found = parameter_set(ssv(*given), "x", "p.ssv")
    assert [one.values for one in found.parameters] == [(1.0, 2.5, -3.0), ("file:x 1",), ("on",), ("x", "y")]
    assert (found.name, found.source, found.parameters[0].unit, found.parameters[1].description) == (
        "p", "p.ssv", "mm", "why",
    )  # fmt: skip


def test_a_mapping_says_where_values_go():
    content = (
        b'<m:ParameterMapping xmlns:m="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" version="1.0">'
        b'<m:MappingEntry source="k" target="plant.k_s"><x:LinearTransformation xmlns:x="c" factor="2" offset="-1"/>'
        b'</m:MappingEntry><m:MappingEntry source="k" target="q" suppressUnitConversion="true"/></m:ParameterMapping>'
    )
    assert mapping_of(parse_xml(content, "x"), "x").entries == (
        MappingEntry("k", "plant.k_s", Transformation(2.0, -1.0)),
        MappingEntry("k", "q", suppress_unit_conversion=True),
    )
    with pytest.raises(InputRefused, match="x: <ParameterSet>; expected <ParameterMapping>"):
        mapping_of(parse_xml(ssv(), "x"), "x")
    with pytest.raises(InputRefused, match="without target"):
        mapping_of(parse_xml(content.replace(b'target="q" ', b""), "x"), "x")


SCHEMAS = Path(fmpy.ssp.__file__).parent / "schema"
NOTE = Annotation("org.example", '<note text="a &amp; b" />')
FAHRENHEIT = UnitDefinition("degF", Dimension(K=1), 5.0 / 9.0, 255.372)
FULL = Metadata("about <it>", "author", "1.2", "nobody's", "BSD-3-Clause", "twin", "2026-01-01T00:00:00Z")
VALUES = ParameterSet(
    "values",
    (
        ParameterValue("k", "Real", (0.1 + 0.2,), "degF", "Sec. 2, 'k'"),
        ParameterValue("n", "Integer", (-3.0,)),
        ParameterValue("on", "Boolean", (1.0,)),
        ParameterValue("name", "String", ("a\nb <c>",)),
        ParameterValue("kind", "Enumeration", ("PI",)),
        ParameterValue("blob", "Binary", ("00ff",)),
    ),
    (FAHRENHEIT,),
    metadata=FULL,
    annotations=(NOTE,),
)
MAPPING = ParameterMapping((MappingEntry("k", "inner.k", Transformation(2.0, 1.0), True), MappingEntry("n", "inner.n")))
STRUCTURE = Structure(
    name="whole",
    system=SspSystem(
        name="outer",
        description="of two",
        elements=(
            SspComponent(
                "a", "resources/a.fmu", implementation="CoSimulation", description="first", annotations=(NOTE,),
                connectors=(Connector("y", "output", "Real", "degF", (), "warm"), Connector("p", "parameter")),
                bindings=(ParameterBinding(VALUES, "left."),),
            ),
            SspSystem(
                "inner",
                elements=(SspComponent("b", "b.ssp", "application/x-ssp-package"),),
                connectors=(Connector("u", "input", "Integer"),),
                connections=(Connection(Endpoint("", "u"), Endpoint("b", "u[1]")),),
            ),
        ),
        connections=(
            Connection(Endpoint("a", "y"), Endpoint("inner", "u"), Transformation(0.1, -1.0 / 3.0), True),
        ),
        bindings=(ParameterBinding(VALUES, mapping=MAPPING),),
        annotations=(NOTE,),
    ),
    units=(FAHRENHEIT, UnitDefinition("1", Dimension()), UnitDefinition("rad/s", Dimension(rad=1, s=-1))),
    enumerations=(("Kind", (("P", 1), ("PI", 2))),),
    experiment=DefaultExperiment(0.0, 20.0, (NOTE,)),
    metadata=FULL,
    annotations=(NOTE,),
)  # fmt: skip


def complaints(content: bytes, name: str) -> list[str]:
    """What the schema `name` of SSP 1.0 has against a file."""
    schema = etree.XMLSchema(etree.parse(SCHEMAS / f"SystemStructure{name}.xsd"))
    schema.validate(etree.fromstring(content))
    return [str(problem) for problem in schema.error_log]


def nothing(source: str, what: str) -> Resource:
    raise AssertionError(source)


def test_a_structure_is_read_back_as_it_was() -> None:
    assert structure_of(structure_xml(STRUCTURE), "x", nothing) == STRUCTURE


def test_values_are_read_back_as_they_were() -> None:
    assert parameter_set(parameter_set_xml(VALUES), "x") == VALUES


@pytest.mark.parametrize(
    ("content", "name"), [(structure_xml(STRUCTURE), "Description"), (parameter_set_xml(VALUES), "ParameterValues")]
)
def test_the_schemas_of_the_standard_have_nothing_against_it(content: bytes, name: str) -> None:
    assert complaints(content, name) == []
    assert complaints(content.replace(b"name=", b"title="), name) != []


def test_sets_and_mappings_of_their_own_files_are_referred_to() -> None:
    bound = ParameterBinding(
        ParameterSet("values", VALUES.parameters, source="resources/v.ssv"),
        mapping=ParameterMapping(MAPPING.entries, source="resources/m.ssm"),
    )
    written = structure_xml(
        Structure("whole", SspSystem("outer", (SspComponent("a", "resources/a.fmu", bindings=(bound,)),)))
    )
    assert complaints(written, "Description") == []
    for referred in (b'parameter-set" source="resources/v.ssv"', b'parameter-mapping" source="resources/m.ssm"'):
        assert referred in written
    assert b"<ssv:" not in written and b"<ssm:" not in written
