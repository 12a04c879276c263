"""Values with units."""

import math
import pickle
from typing import Literal, get_args

import pytest
from pydantic import ValidationError

from twin.kernel.cosim.port import record_of
from twin.kernel.settings import Settings, Values, numbers, setting, setting_fields
from twin.robot.plant.contact import Shape
from twin.robot.plant.contact_law import Contact, ContactLaw, Law


class Table(Settings):
    length: float = setting("mm", default=-101.0, help="meaning")
    angles: tuple[float, ...] = setting("deg", help="meaning")
    bare: float = setting("s", default=2.0, help="meaning")
    rate: float = setting("1/mm", default=1.0, help="meaning")
    missing: float | None = setting("N", default=None, help="meaning")


def test_the_key_carries_the_unit_and_the_attribute_is_si():
    table = Table.model_validate({"angles_deg": (180.0, 90.0)})
    assert (table.length, table.bare, table.missing) == (-0.101, 2.0, None)
    assert table.angles == (3.141592653589793, 1.5707963267948966)


def test_a_number_that_overflows_in_si_units_is_refused():
    with pytest.raises(ValidationError, match="finite in SI units"):
        Table.model_validate({"angles_deg": (0.0,), "length_mm": 1.0, "rate_per_mm": 1e308})


def test_choices_count_as_the_compiled_code_does():
    assert list(get_args(Law)) == [law.name.lower() for law in ContactLaw]
    assert list(get_args(Contact.model_fields["shape"].annotation)) == [shape.name.lower() for shape in Shape]


class Spring(Settings):
    stiffness: float = setting("N/mm", gt=0, field="k", broken_by=("softened",), help="stiffness")
    stop: float | None = setting("mm", default=None, absent=math.inf, help="stop; without it, none")
    kind: Literal["coil", "leaf"] = setting(default="coil", help="kind")
    name: str = setting(default="", help="for people")
    rate: float = setting("Hz", into="filter", default=2.0, help="of another record")


class Parameters(
    Values, parts=(setting_fields(Spring), {"age": setting("s", default=0.0, help="how old")}), first="stop"
):
    """Of a spring."""


def test_a_record_has_the_numbers_and_choices_of_its_tables_and_what_no_file_says():
    assert Parameters._fields == ("stop", "k", "kind", "age")
    assert record_of(Parameters).names == Parameters._fields and record_of(Parameters)["kind"] == "i8"
    table = Spring.model_validate({"stiffness_N_per_mm": 2.0, "kind": "leaf"})
    assert Parameters.from_tables(table) == (math.inf, 2000.0, 1, 0.0)
    assert Parameters.from_tables(table, age=3.0)._replace(k=1.0)._asdict() == {
        "stop": math.inf, "k": 1.0, "kind": 1, "age": 3.0
    }  # fmt: skip
    assert Parameters.broken_by == {"softened": "k"} and numbers(table, into="filter") == {"rate": 2.0}
    with pytest.raises(TypeError, match="no field for"):
        Parameters(speed=1.0)
    assert pickle.loads(pickle.dumps(Parameters(k=1.0))) == Parameters(k=1.0)
