"""The matrix itself: the healthy run first, then one row after the other."""

from collections.abc import Iterator, Sequence

import numpy as np

from twin.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.experiment.experiment import Experiment
from twin.experiment.fault import NEVER
from twin.monitor.reasons import trip_sentence
from twin.runs.assembly.roles import refuse_other_parts
from twin.studies.faults.case import Case
from twin.studies.faults.onset import default_onsets, touching
from twin.studies.faults.row import End, FaultOutcome, FaultRow
from twin.studies.faults.trial import FaultTrial, trial

FAILURE = "FAILURE"


def healthy_trial(experiment: Experiment) -> FaultTrial:
    """The run that every row is compared with: no fault, with the monitor.

    Raises:
        InputRefused: nobody watches in `experiment`, or it has faults of its own.
        SafetyTrip: the monitor trips although nothing is wrong; nothing can be said of faults then.
        ComponentFailed: a component failed.
    """
    if experiment.monitor is None:
        raise InputRefused(
            f"{experiment.name}: no safety monitor watches this experiment; add a table [monitor] (its limits have "
            "defaults) without enabled = false, or --set monitor.enabled=true"
        )
    refuse_other_parts(experiment, "a matrix of faults", ("monitor",))
    if experiment.faults:
        raise InputRefused(
            f"{experiment.name}: has [[fault]] tables; the matrix puts in one fault at a time, remove them"
        )
    healthy = trial(experiment, None, watched=True)
    if healthy.trip is not None:
        raise SafetyTrip(f"{experiment.name}: without any fault: {trip_sentence(healthy.trip)}")
    if healthy.failure:
        raise ComponentFailed(f"{experiment.name}: without any fault: {healthy.failure}")
    return healthy


def onsets_of(experiment: Experiment, healthy: FaultTrial, wanted: Sequence[float]) -> tuple[float, ...]:
    """The onsets `wanted` (s), or if there are none, those that the healthy run suggests.

    Raises:
        InputRefused: see `default_onsets`.
    """
    return tuple(wanted) or tuple(tick * experiment.cosim.tick for tick in default_onsets(healthy))


def matrix_rows(experiment: Experiment, healthy: FaultTrial, cases: Sequence[Case]) -> Iterator[FaultRow]:
    """One row per case, as they come.

    Raises:
        InputRefused: a fault does not fit this robot.
    """
    assert experiment.monitor is not None
    tick, limit = experiment.cosim.tick, experiment.monitor.force_limit
    for case in cases:
        fault = case.fault
        watched, unwatched = (
            outcome(trial(experiment, fault, watched), fault.onset, tick, limit) for watched in (True, False)
        )
        yield FaultRow(
            kind=fault.kind,
            target=fault.target,
            magnitude=case.magnitude,
            onset=fault.onset * tick,
            in_contact=bool(touching(healthy)[fault.onset]),
            limit=limit,
            healthy_peak=float(healthy.force[fault.onset :].max()),
            watched=watched,
            unwatched=unwatched,
            stays=fault.end == NEVER,
        )


def outcome(run: FaultTrial, onset: int, tick: float, limit: float) -> FaultOutcome:
    """What `run` did from tick `onset` on.

    Args:
        tick: (s).
        limit: of the force (N).
    """
    force = run.force[onset:]
    at_fault = run.culprit.startswith("fault_")
    tripped = run.trip.tick if run.trip else len(run.force) - 1 if at_fault else None
    return FaultOutcome(
        # the row of the tick in which a step fails is there
        peak=float(force.max()),
        peak_delay=float(tick * force.argmax()),
        above=float(tick * np.count_nonzero(force > limit)),
        reason=run.trip.reason.name if run.trip else FAILURE if at_fault else "",
        delay=None if tripped is None else tick * (tripped - onset),
        power_off_delay=None if run.power_off_tick is None else tick * (run.power_off_tick - onset),
        end=_end(run),
        failure=run.failure,
    )


def _end(run: FaultTrial) -> End:
    if run.failure:
        return "run ended"
    if run.power_off_tick is not None:
        return "power off"
    if run.trip is None:
        return "finished"
    return "held" if touching(run)[-1] else "retracted"
