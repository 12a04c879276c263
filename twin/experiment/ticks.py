"""Times of an experiment as whole ticks."""

MOST_TICKS = 1e12
"""Three centuries at 10 ms, or what nobody means."""


def whole_ticks(time: float, tick: float) -> int | None:
    """How many ticks (s) `time` (s) is; None if it is no whole number of them, up to rounding of the two, or more than
    `MOST_TICKS`."""
    if time / tick > MOST_TICKS:
        return None
    count = round(time / tick)
    return count if abs(count * tick - time) <= 1e-9 * time else None
