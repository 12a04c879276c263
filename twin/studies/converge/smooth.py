"""Experiments without quantisation to ticks or counts, so that only the coupling makes a difference.

An error in the time of an event is of order one in the tick for any coupling; an encoder's count is as large as many a
coupling error; and a trigger decided by a count shifts by whole periods.
"""

from dataclasses import dataclass, replace

import numpy as np

from twin.kernel.errors import InputRefused
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment, with_exact_encoders, with_plant
from twin.robot.run.trace import run_in_memory

OUT_OF_REACH = 1e9
"""A trigger force (N) that is never reached."""


@dataclass(frozen=True)
class SmoothExperiment:
    """An experiment without quantisation, and a phrase for each removed effect."""

    experiment: Experiment
    changes: tuple[str, ...]


def comparable_experiment(experiment: Experiment) -> SmoothExperiment:
    """Return the experiment with exact encoders and a force loop triggered by time instead of by force."""
    if experiment.faults:
        raise InputRefused(f"{experiment.name}: has faults, whose effect is not a coupling error; remove [[fault]]")
    if experiment.tasks:
        raise InputRefused(
            f"{experiment.name}: its tasks change phase at the measured force, so two runs are not comparable "
            "in time; choose an experiment with a [reference]"
        )
    p = experiment.plant
    if p.spring_hysteresis or p.spring_stop is not None:
        key = "spring_hysteresis" if p.spring_hysteresis else "spring_stop_deg"
        raise InputRefused(
            f"{experiment.name}: [plant] {key}: the energy that a coupling makes is known only for springs "
            "without hysteresis and stop; remove it from [plant]"
        )
    changes = ["encoders exact"]
    smooth = with_exact_encoders(experiment)
    refuse_third_party_parts(experiment, "a study of the coupling", ("controller", "estimator"))
    if experiment.monitor is not None:
        # the monitor assumes the robot's real encoders
        smooth = replace(smooth, monitor=None)
        changes.append("no safety monitor")
    triggered = np.flatnonzero(run_in_memory(experiment, only=["controller.triggered"]).held("controller.triggered"))
    if len(triggered) and experiment.controller.force.trigger is not None:
        when = float(triggered[0] * experiment.cosim.tick)
        force = experiment.controller.force.model_copy(update={"trigger": OUT_OF_REACH, "trigger_time": when})
        smooth = replace(smooth, controller=smooth.controller.model_copy(update={"force": force}))
        changes.append(f"force loop on at {when:g} s, not by force")
    return SmoothExperiment(smooth, tuple(changes))


def without_friction(smooth: SmoothExperiment) -> SmoothExperiment:
    """Remove backlash and friction from an experiment, too, so that its motion has no events."""
    experiment = with_plant(smooth.experiment, backlash=0.0, joint_friction=0.0)
    contact = experiment.contact.model_copy(update={"friction": 0.0})
    return SmoothExperiment(
        replace(experiment, contact=contact), (*smooth.changes, "no backlash", "no friction under the head")
    )
