"""Values with units."""

from twin.experiment.quantity import Section, quantity


class Table(Section):
    length: float = quantity("length_mm", -101.0)
    angles: tuple[float, ...] = quantity("angles_deg")
    bare: float = quantity("bare_s", 2.0)
    missing: float | None = quantity("missing_N", None)


def test_the_key_carries_the_unit_and_the_attribute_is_si():
    table = Table.model_validate({"angles_deg": (180.0, 90.0)})
    assert (table.length, table.bare, table.missing) == (-0.101, 2.0, None)
    assert table.angles == (3.141592653589793, 1.5707963267948966)
