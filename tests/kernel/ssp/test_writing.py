"""What is written is a file of the standard, and is read back as what it was."""

from pathlib import Path

import fmpy.ssp
import pytest
from lxml import etree

from twin.kernel.ssp.parameters import (
    Annotation,
    MappingEntry,
    Metadata,
    ParameterBinding,
    ParameterMapping,
    ParameterSet,
    ParameterValue,
    Transformation,
    UnitDefinition,
)
from twin.kernel.ssp.ssd import Resource, parameter_set, structure_of
from twin.kernel.ssp.structure import (
    Connection,
    Connector,
    DefaultExperiment,
    Endpoint,
    SspComponent,
    SspSystem,
    Structure,
)
from twin.kernel.ssp.writing import parameter_set_xml, structure_xml
from twin.kernel.units import Dimension

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
