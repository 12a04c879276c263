"""How often a drive is stepped, and until when."""

from twin.errors import InputRefused
from twin.experiment.schema import Drive


def rates(name: str, table: Drive, tick: float) -> tuple[int, int]:
    """(inner ticks per tick, inner ticks per command of ours; where nothing is said of it, one command per tick)."""
    key, loop = next(
        ((key, found) for key in ("velocity_loop", "position_command") if (found := getattr(table, key))), ("", None)
    )
    if loop is None or loop.period is None:
        return table.substeps, table.substeps
    substeps = max(table.substeps, round(tick / loop.period))
    period = round(loop.period / (tick / substeps))
    if period < 1 or abs(period * tick / substeps - loop.period) > 1e-9 * loop.period:
        raise InputRefused(
            f"{name}: [drive.{key}] period_ms = {1e3 * loop.period:g} does not divide into the "
            f"{substeps} steps per tick of {1e3 * tick:g} ms; choose a period or substeps that fit"
        )
    return substeps, period
