"""Units of columns."""

import pytest

from twin.recording.logs.errors import LogRefused
from twin.recording.logs.units import unit


def test_an_unknown_unit_is_refused_with_the_nearest():
    with pytest.raises(LogRefused, match=r"a.csv: column 'F': unknown unit 'kgff'; did you mean 'kgf'\?"):
        unit("kgff", "a.csv: column 'F'")
