"""Reaction of the monitor to a fault, and its effect on the person: peak force, times, impulse, energy."""

import hashlib
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.robot.experiment.experiment import Experiment
from twin.robot.run.runs import Outcome
from twin.studies.faults.onsets import CONTACT_FORCE, FORCE_SIGNAL, PLACE_SIGNAL

SPEED_SIGNAL = "plant.v_B"
REACTION_SIGNALS = frozenset({FORCE_SIGNAL, PLACE_SIGNAL, SPEED_SIGNAL})
BEARABLE_FORCE = 10.0
"""Maximum bearable force (N): the force of a firm thumb, two thirds of the force limit."""
LAST_TIME = 0.1
"""Time (s) at the end of a run over which the remaining force is averaged."""
FAILURE_REASON = "FAILURE"
"""Reason of a run that the fault itself ended."""

End = Literal["finished", "retracted", "held", "power off", "run ended"]
"""End of a run: without a trip; clear of the body, or still touching it, after the retraction; without power because a
drive did not retract; early because a component failed."""


@dataclass(frozen=True)
class Reaction:
    """Reaction of the monitor and the robot in one run with faults, from the onset of the faults on, SI.

    Attributes:
        seen: time to the trip of the monitor, or to the failure of the fault itself; None if there is neither.
        acted: time to the first command or power at the drives that is the monitor's; None without a trip.
        power_off: time to the loss of power, of one drive at least; None if the power stays.
        below: last time that the force falls below `BEARABLE_FORCE`; 0 if it never exceeds it; None if it is above at
            the end.
        reason: a name of `twin.robot.monitor.reasons.Reason`, or FAILURE_REASON; "" if `seen` is None.
        peak: largest true force (N).
        peak_delay: time to the peak.
        above: duration of a true force above the monitor's force limit.
        impulse: integral of the true force (N s).
        energy: largest energy that the robot has given to the body (J).
        left: true force at the end (N).
        end: see `End`.
        failure: error message that ended the run; "".
        digest: digest of the true force's bits, which identifies a run on the same kind of machine; "" if it was not
            requested.
    """

    seen: float | None
    acted: float | None
    power_off: float | None
    below: float | None
    reason: str
    peak: float
    peak_delay: float
    above: float
    impulse: float
    energy: float
    left: float
    end: End
    failure: str
    digest: str = ""

    JSON_KEYS = (
        "seen_s=seen acted_s=acted power_off_s=power_off below_s=below reason peak_N=peak impulse_N_s=impulse "
        "energy_J=energy left_N=left failure digest"
    )


def reaction(run: Outcome, experiment: Experiment, onset: int, digest: bool = True) -> Reaction:
    """Evaluate the reaction in a watched `experiment` from tick `onset` on; the digest takes 0.5 ms."""
    assert run.trace is not None
    tick = experiment.cosim.tick
    # a run that fails in its first step has no row: the robot has touched nothing
    made = len(run.trace[FORCE_SIGNAL])
    F, v = (run.trace[name][onset:] if made > onset else np.zeros((1, 3)) for name in (FORCE_SIGNAL, SPEED_SIGNAL))
    force = np.linalg.norm(F, axis=1)
    high = np.flatnonzero(force >= BEARABLE_FORCE)
    given = tick * np.cumsum(np.einsum("ij,ij->i", F, v))
    trip, off = run.trip, run.power_off_tick
    at_fault = run.culprit.startswith("fault_")
    tripped = trip.tick if trip else max(onset, made - 1) if at_fault else None
    seen = None if tripped is None else tick * (tripped - onset)
    limit = np.inf if experiment.monitor is None else experiment.monitor.force_limit
    return Reaction(
        seen=seen,
        acted=None if seen is None or trip is None else seen + tick * experiment.controller.bus_delay_ticks,
        power_off=None if off is None else tick * (off - onset),
        below=0.0 if not len(high) else None if high[-1] == len(force) - 1 else tick * (int(high[-1]) + 1),
        reason=trip.reason.name if trip else FAILURE_REASON if at_fault else "",
        peak=float(force.max()),
        peak_delay=float(tick * force.argmax()),
        above=float(tick * np.count_nonzero(force > limit)),
        impulse=float(tick * force.sum()),
        energy=max(0.0, float(given.max())),
        left=float(force[-max(1, round(LAST_TIME / tick)) :].mean()),
        end=_end(run, float(force[-1])),
        failure=str(run.failure or ""),
        digest=hashlib.sha256(run.trace[FORCE_SIGNAL].tobytes()).hexdigest()[:12] if digest else "",
    )


def _end(run: Outcome, last_force: float) -> End:
    if run.failure:
        return "run ended"
    if run.power_off_tick is not None:
        return "power off"
    if run.trip is None:
        return "finished"
    return "held" if last_force >= CONTACT_FORCE else "retracted"
