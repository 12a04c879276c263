"""Wall time and disk space of a run, estimated before it starts."""

from collections.abc import Sequence

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import LONG_RUN_DURATION, duration_text
from twin.robot.experiment.experiment import Experiment

SECONDS_PER_TICK = 20e-6
"""Wall time (s) per tick, stepping and recording, with a compiled drive; a drive in Python needs ten times as long."""
BYTES_PER_TICK = 350
"""Recording size (bytes) per tick: 300 to 410 with the shipped experiments and drives, half at rate "controller"."""
MAX_DISK_BYTES = 5e9
"""Maximum size (bytes) of recordings that start without confirmation."""


def estimate(experiment: Experiment) -> tuple[float, float]:
    """Return the estimated wall time (s) and recording size (bytes) of a run."""
    ticks = experiment.duration_ticks
    shortest = experiment.controller_ticks if experiment.recording.rate == "controller" else 1
    return ticks * SECONDS_PER_TICK, ticks / shortest * BYTES_PER_TICK


def refuse_endless(experiments: Sequence[Experiment], factor: float | None = None) -> None:
    """Refuse runs that take very long or fill the disk, unless the user confirms them.

    `factor` is the simulated time per wall time; None or 0 for as fast as possible.
    """
    costs = [estimate(experiment) for experiment in experiments]
    seconds, size = (sum(cost[i] for cost in costs) for i in (0, 1))
    if factor:
        seconds = max(seconds, sum(one.duration_ticks * one.cosim.tick for one in experiments) / factor)
    if seconds <= LONG_RUN_DURATION and size <= MAX_DISK_BYTES:
        return
    raise InputRefused(
        f"{', '.join(experiment.name for experiment in experiments)}: would take about "
        f"{duration_text(seconds)} and {size / 1e9:,.0f} GB; --yes runs it anyway, --set duration_s=... shortens it"
    )
