"""The part of a log that says what is normal."""

import math

from twin.errors import InputRefused


def normal_time(text: str) -> tuple[float, float]:
    """(from, to) in s after the log's first sample: `2` is 0 to 2, `1:3` leaves the first second out.

    Raises:
        InputRefused: no such times.
    """
    first, colon, last = text.rpartition(":")
    try:
        begin, end = float(first) if colon else 0.0, float(last)
    except ValueError:
        begin = end = math.nan
    if not (math.isfinite(end) and 0.0 <= begin < end):
        raise InputRefused(f"--baseline {text}: expected a time > 0 s, or FROM:TO with 0 <= FROM < TO, for example 1:3")
    return begin, end
