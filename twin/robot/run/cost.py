"""Time and disk space that a run takes, estimated before it begins."""

from collections.abc import Sequence

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import LONG_RUN_DURATION, duration_text
from twin.robot.experiment.experiment import Experiment

SECONDS_PER_TICK = 20e-6
"""Stepping and recording with a drive of compiled code; one written in Python takes ten times as long."""
BYTES_PER_TICK = 350
"""Of a recording; the shipped experiments and drives take 300 to 410. Half of it at the controller's rate."""
MAX_DISK_BYTES = 5e9
"""Size (bytes) beyond which a run starts only after a question."""


def estimate(experiment: Experiment) -> tuple[float, float]:
    """(s, bytes) that a run of `experiment` takes, about."""
    ticks = experiment.duration_ticks
    shortest = experiment.controller_ticks if experiment.recording.rate == "controller" else 1
    return ticks * SECONDS_PER_TICK, ticks / shortest * BYTES_PER_TICK


def refuse_endless(experiments: Sequence[Experiment], factor: float | None = None) -> None:
    """Ask the user whether runs that take very long or fill the disk are meant.

    Args:
        experiments: to be run one after the other.
        factor: simulated time per wall time; None or 0: as fast as it goes.

    Raises:
        InputRefused: more than `LONG_RUN_DURATION` or `MAX_DISK_BYTES`; it says how much.
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
