"""Times of an experiment as whole ticks."""


def whole_ticks(time: float, tick: float) -> int | None:
    """How many ticks (s) `time` (s) is; None if it is no whole number of them, up to rounding of the two."""
    count = round(time / tick)
    return count if abs(count * tick - time) <= 1e-9 * time else None
