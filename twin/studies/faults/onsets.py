"""Onsets of faults in free motion and in contact, chosen from a healthy run of the experiment."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.reasons import trip_message
from twin.robot.run.runs import Outcome, RunRequest, Runs

FORCE_SIGNAL, PLACE_SIGNAL = "plant.F_ee_B", "plant.p_B"
"""Signals that the onsets are computed from: true contact force and position of the platform."""
CONTACT_FORCE = 0.5
"""Minimum true force (N) of a contact: half the monitor's threshold for the start of a contact."""


def healthy_run(experiment: Experiment) -> Outcome:
    """Run an experiment without faults, and keep its force and position."""
    return Runs(RunRequest(frozenset({FORCE_SIGNAL, PLACE_SIGNAL})), most=0).run(experiment)


def checked_healthy_run(experiment: Experiment) -> Outcome:
    """Run an experiment without faults but with its monitor; reject it if the monitor trips or a component fails."""
    if experiment.monitor is None:
        raise InputRefused(
            f"{experiment.name}: no safety monitor watches this experiment; add a table [monitor] (its limits have "
            "defaults) without enabled = false, or --set monitor.enabled=true"
        )
    refuse_third_party_parts(experiment, "a matrix of faults", ("monitor",))
    if experiment.faults:
        raise InputRefused(
            f"{experiment.name}: has [[fault]] tables; the matrix inserts one fault at a time, remove them"
        )
    healthy = healthy_run(experiment)
    if healthy.trip is not None:
        raise SafetyTrip(f"{experiment.name}: without any fault: {trip_message(healthy.trip)}")
    if healthy.failure:
        raise ComponentFailed(f"{experiment.name}: without any fault: {healthy.failure}")
    return healthy


def true_force(run: Outcome) -> NDArray[np.float64]:
    """Return the true contact force (N) of a run in each tick, (ticks,); truncated if a component failed."""
    assert run.trace is not None
    return np.linalg.norm(run.trace[FORCE_SIGNAL], axis=1)


def touching(run: Outcome) -> NDArray[np.bool_]:
    """Return whether the robot touches the body in each tick of a run, (ticks,)."""
    return true_force(run) >= CONTACT_FORCE


def default_onsets(healthy: Outcome) -> tuple[int, int]:
    """Choose two default fault onsets from a healthy run: a tick in free motion and a tick in contact.

    The first is the middle of the descent to the first contact, the second the middle of the longest contact: the hold
    of a press, the deepest part of a tap, the sweep of Fig. 4. A robot that never touches the body is refused.
    """
    contacts = _spans(touching(healthy))
    if len(contacts) == 0:
        raise InputRefused("the healthy run touches nothing, so there is no usual onset; give one with --onset S")
    assert healthy.trace is not None
    first, z = int(contacts[0, 0]), healthy.trace[PLACE_SIGNAL][:, 2]
    rests = np.flatnonzero(np.diff(z[: first + 1]) >= 0.0)
    descent = int(rests[-1]) + 1 if len(rests) else 0
    longest = contacts[np.argmax(contacts[:, 1] - contacts[:, 0])]
    return (descent + first) // 2, int(longest.sum()) // 2


def _spans(true: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Find the unbroken stretches of True in an array, (n, 2): first index, and the index after the last."""
    edges = np.diff(np.concatenate([[False], true, [False]]).astype(int))
    return np.flatnonzero(edges).reshape(-1, 2)
