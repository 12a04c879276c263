"""The same experiment with one thing changed, SI: what studies of the twin itself are made of.

Whoever writes experiments changes keys of the file; these change what has already been checked.
"""

from dataclasses import replace
from typing import Any

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment

EXACT = 2**40
"""Counts per turn of an encoder that might as well not be there: a count is 6e-12 rad."""


def with_plant(experiment: Experiment, **values: Any) -> Experiment:
    """With other true values of [plant]."""
    return replace(experiment, plant=experiment.plant.model_copy(update=values))


def with_model(experiment: Experiment, **values: Any) -> Experiment:
    """With other beliefs of the controller, [controller.model]."""
    computer = experiment.controller
    model = computer.model.model_copy(update=values)
    return replace(experiment, controller=computer.model_copy(update={"model": model}))


def with_cosim(experiment: Experiment, **values: Any) -> Experiment:
    """With another tick (s), scheme, way of inputs or number of iterations; durations and periods stay.

    Raises:
        InputRefused: a duration or period is not a whole number of the new ticks.
    """
    cosim = experiment.cosim.model_copy(update=values)
    counts: dict[str, Any] = {
        name: _recounted(experiment, name, cosim.tick)
        for name, there in (
            ("duration_ticks", True),
            ("controller_ticks", True),
            ("scale_ticks", experiment.scale is not None),
            ("monitor_ticks", experiment.monitor is not None),
        )
        if there
    }
    return replace(experiment, cosim=cosim, **counts)


def exactly_measured(experiment: Experiment) -> Experiment:
    """With encoders that neither round nor add noise, and a controller that knows them."""
    counts = {"motor_counts_per_turn": EXACT, "joint_counts_per_turn": EXACT}
    return with_model(with_plant(experiment, motor_noise=0.0, joint_noise=0.0, **counts), **counts)


def shortened(experiment: Experiment, duration: float) -> Experiment:
    """The first `duration` seconds of it, to whole periods of the controller; all of it if it is shorter."""
    period = experiment.controller_ticks
    ticks = max(1, round(duration / (period * experiment.cosim.tick))) * period
    return replace(experiment, duration_ticks=min(ticks, experiment.duration_ticks))


def _recounted(experiment: Experiment, name: str, tick: float) -> int:
    length = getattr(experiment, name) * experiment.cosim.tick
    ticks = round(length / tick)
    if ticks < 1 or abs(ticks * tick - length) > 1e-9 * length:
        raise InputRefused(
            f"{experiment.name}: {name.removesuffix('_ticks')} of {length:g} s is not a whole number of ticks of "
            f"{tick:g} s"
        )
    return ticks
