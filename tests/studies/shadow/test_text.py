"""What a session says of itself: the line while it goes on."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.recording.sources.stamps import Counts
from twin.studies.shadow.text import status_line

MAYBE = st.one_of(st.just(math.nan), st.floats(0.0, 1e9))
WHOLE = st.integers(0, 10**8)


@pytest.mark.parametrize(
    ("missing", "NIS", "level", "line"),
    [
        (0, 1.02, 0.134, "12.3 s  500 Hz  late 3.1 ms  0 missing in 0 gaps  NIS 1.02  alarm 0.134"),
        (0, 1.02, math.nan, "12.3 s  500 Hz  late 3.1 ms  0 missing in 0 gaps  NIS 1.02  joints 0.004 deg"),
        (0, math.nan, math.nan, "12.3 s  500 Hz  late 3.1 ms  0 missing in 0 gaps  joints 0.004 deg"),
        (3, math.nan, 1.5, "12.3 s  500 Hz  late 3.1 ms  3 missing in 1 gap  alarm 1.5  joints 0.004 deg"),
    ],
)
def test_the_line_says_what_is_there_and_nothing_of_what_is_not(missing: int, NIS: float, level: float, line: str):
    counts = Counts(samples=6000, missing=missing, gaps=min(missing, 1))
    assert status_line(12.3, 0.002, 0.0031, counts, NIS, level, math.radians(0.004)) == line


@given(
    st.floats(0.0, 1e6), st.one_of(st.just(math.inf), st.floats(1e-4, 10.0)), MAYBE, WHOLE, WHOLE, MAYBE, MAYBE, MAYBE
)
def test_the_line_never_has_80_columns_and_always_says_rate_gaps_nis_and_alarm(
    t: float, period: float, late: float, missing: int, gaps: int, NIS: float, level: float, joints: float
):
    line = status_line(t, period, late, Counts(missing=missing, gaps=gaps), NIS, level, joints)
    assert len(line) < 80
    assert " Hz" in line and f"{gaps} gap" in line and "nan" not in line
    assert ("NIS" in line, "alarm" in line) == (math.isfinite(NIS), math.isfinite(level))
