"""Parameter files: what is in them is read, what is no value is refused."""

import pytest

from tests.studies.reference.test_carried import real, ssv
from twin.kernel.errors import InputRefused
from twin.kernel.files import xml_of
from twin.kernel.ssp.parameters import MappingEntry, Transformation
from twin.kernel.ssp.ssd import mapping_of, parameter_set


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
    monkeypatch.setattr("twin.kernel.ssp.ssd.MOST_PARAMETERS", 2)
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
    assert mapping_of(xml_of(content, "x"), "x").entries == (
        MappingEntry("k", "plant.k_s", Transformation(2.0, -1.0)),
        MappingEntry("k", "q", suppress_unit_conversion=True),
    )
    with pytest.raises(InputRefused, match="x: <ParameterSet>; expected <ParameterMapping>"):
        mapping_of(xml_of(ssv(), "x"), "x")
    with pytest.raises(InputRefused, match="without target"):
        mapping_of(xml_of(content.replace(b'target="q" ', b""), "x"), "x")
