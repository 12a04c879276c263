"""Values with units."""

import pytest
from pydantic import ValidationError

from twin.settings import Settings, setting


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
