"""The way of a value: what it is multiplied with and what is added, however many parts it has."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.cosim.ssp.flat import Hop
from twin.cosim.ssp.unit import Transformation, UnitDefinition
from twin.errors import InputRefused
from twin.studies.systems.way import Way, spelt, way
from twin.units import Dimension

LENGTH = Dimension(m=1)
UNITS = (
    UnitDefinition("m", LENGTH),
    UnitDefinition("inch", LENGTH, 0.0254),
    UnitDefinition("over", LENGTH, 2.0, -3.0),
    UnitDefinition("s", Dimension(s=1)),
)
names = st.sampled_from(["m", "inch", "over", ""])
numbers = st.floats(-1e3, 1e3)
factors = numbers.filter(lambda factor: abs(factor) > 1e-3)
hops = st.lists(
    st.builds(Hop, st.builds(Transformation, factors, numbers), st.booleans(), names), min_size=1, max_size=4
)


def si(value: float, unit: str) -> float:
    factor, offset = {one.name: (one.factor, one.offset) for one in UNITS}[unit]
    return factor * value + offset


def by_hand(value: float, start: str, parts: list[Hop], end: str) -> float:
    """As the standard tells it: to the unit of where it gets, then the line."""
    here = start
    for number, (line, suppressed, unit) in enumerate(parts):
        there = end if number == len(parts) - 1 else unit
        if here and there and not suppressed:
            factor, offset = {one.name: (one.factor, one.offset) for one in UNITS}[there]
            value = (si(value, here) - offset) / factor
        value = line.factor * value + line.offset
        here = there or here
    return value


@given(numbers, names, hops, names)
def test_the_whole_way_is_its_parts_one_after_the_other(value: float, start: str, parts: list[Hop], end: str):
    whole = way(spelt(start, UNITS), parts, spelt(end, UNITS), UNITS, "x")
    # roundings of sums whose terms may cancel: of the largest term there can be
    size = math.prod(abs(part.transformation.factor) * 80.0 + 1.0 for part in parts) * 1e4
    assert whole.end(value) == pytest.approx(by_hand(value, start, parts, end), rel=1e-9, abs=1e-13 * size)


@given(numbers)
def test_a_way_on_which_nothing_happens_changes_no_bit(value: float):
    for one, other in (("inch", "inch"), ("", "m"), ("m", ""), ("", "")):
        led = way(spelt(one, UNITS), [Hop(), Hop()], spelt(other, UNITS), UNITS, "x")
        assert led == Way() and led.end(value) == value


@pytest.mark.parametrize(
    ("start", "line", "end", "told"),
    [
        ("m", Transformation(), "s", "from 'm' to 's', which do not measure the same"),
        ("m", Transformation(), "ell", "nobody says what the unit 'ell' is"),
        ("m", Transformation(0.0), "m", "the factor 0"),
        ("m", Transformation(5e-324), "m", "more or less than a number can hold"),
        ("m", Transformation(1e-300, 1e300), "m", "more or less than a number can hold"),
        (
            "m",
            Transformation(table="IntegerMappingTransformation"),
            "m",
            "IntegerMappingTransformation cannot be done here",
        ),
    ],
)
def test_a_way_that_leads_nowhere_is_refused(start: str, line: Transformation, end: str, told: str):
    with pytest.raises(InputRefused) as refused:
        way(spelt(start, UNITS), [Hop(line)], spelt(end, UNITS), UNITS, "x")
    assert told in str(refused.value)
