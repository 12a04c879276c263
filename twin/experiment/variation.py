"""The same experiment with one thing changed, SI: what studies of the twin itself are made of.

Whoever writes experiments changes keys of the file; these change what has already been checked.
"""

from dataclasses import replace
from typing import Any

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.ticks import whole_ticks

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
    """With another tick (s), scheme, way of inputs or number of iterations; whatever is counted in ticks stays as long.

    Args:
        experiment: without faults, whose onsets are counted too.

    Raises:
        InputRefused: a duration, a period, a delay or the time of a change is not a whole number of the new ticks.
    """
    cosim = experiment.cosim.model_copy(update=values)

    def recounted(name: str, ticks: int) -> int:
        length = ticks * experiment.cosim.tick
        count = whole_ticks(length, cosim.tick)
        if not count:
            told = f"{name} of {length:g} s is not a whole number of ticks of {cosim.tick:g} s"
            raise InputRefused(f"{experiment.name}: {told}")
        return count

    optional = [name for name in ("scale", "monitor") if getattr(experiment, name) is not None]
    counts: dict[str, Any] = {
        f"{name}_ticks": recounted(name, getattr(experiment, f"{name}_ticks"))
        for name in ("duration", "controller", *optional)
    }
    changes = tuple(replace(change, tick=recounted("time of a change", change.tick)) for change in experiment.changes)
    delays = {
        key: recounted(name, ticks)
        for key, name in (("delay_ticks", "delay"), ("bus_delay_ticks", "delay of the bus"))
        if (ticks := getattr(experiment.controller, key))
    }
    if experiment.plant.encoder_latency:
        recounted("latency of the encoders", whole_ticks(experiment.plant.encoder_latency, experiment.cosim.tick) or 0)
    computer = experiment.controller.model_copy(update=delays)
    return replace(experiment, cosim=cosim, controller=computer, changes=changes, **counts)


def exactly_measured(experiment: Experiment) -> Experiment:
    """With encoders that neither round nor add noise, and a controller that knows them."""
    counts = {"motor_counts_per_turn": EXACT, "joint_counts_per_turn": EXACT}
    return with_model(with_plant(experiment, motor_noise=0.0, joint_noise=0.0, **counts), **counts)


def shortened(experiment: Experiment, duration: float) -> Experiment:
    """The first `duration` seconds of it, to whole periods of the controller; all of it if it is shorter."""
    period = experiment.controller_ticks
    ticks = max(1, round(duration / (period * experiment.cosim.tick))) * period
    return replace(experiment, duration_ticks=min(ticks, experiment.duration_ticks))
