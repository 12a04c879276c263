"""How often a drive is stepped, and until when."""

from twin.errors import InputRefused
from twin.experiment.schema import Drive


def rates(name: str, table: Drive, tick: float) -> tuple[int, int]:
    """(inner ticks per tick, inner ticks per period of the velocity loop)."""
    loop = table.velocity_loop
    if loop is None:
        return table.substeps, 1
    substeps = max(table.substeps, round(tick / loop.period))
    period = round(loop.period / (tick / substeps))
    if period < 1 or abs(period * tick / substeps - loop.period) > 1e-9 * loop.period:
        raise InputRefused(
            f"{name}: [drive.velocity_loop] period_ms = {1e3 * loop.period:g} does not divide into the "
            f"{substeps} steps per tick of {1e3 * tick:g} ms; choose a period or substeps that fit"
        )
    return substeps, period


def stop_time(ticks: int | None, tick: float, substeps: int) -> float | None:
    """When the last step ends (s): the run's duration, or what t + h of that step is rounded to, if that is later."""
    if ticks is None:
        return None
    step = tick / substeps
    return max(ticks * tick, (ticks * substeps - 1) * step + step)
