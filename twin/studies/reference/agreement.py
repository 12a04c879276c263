"""Whether what an FMU did here is what its results say, within a tolerance of ours: no standard states one."""

from typing import NamedTuple

import numpy as np

from twin.studies.reference.bare_run import BareRun
from twin.studies.reference.series import Series

OF_RANGE = 0.01
OF_SIZE = 1e-4
"""For signals that hardly move: results are often written with six digits."""
LEAST = 1e-9
TOLERANCE = (
    f"{100 * OF_RANGE:g} % of a signal's range in the results, at some moment within one step of that of the result: "
    "a tolerance of ours, the files state none"
)
"""One step, because inputs are held over it and a jump is seen at its end."""


class Deviation(NamedTuple):
    """Of a signal: how far it leaves the results at most, in multiples of the tolerance, and when (s)."""

    signal: str
    share: float
    t: float


def deviations(run: BareRun, results: Series) -> list[Deviation]:
    """Every signal of a run that the results have, in their order."""
    within = results.t <= (1.0 + 1e-9) * run.t[-1]
    t = results.t[within]
    if not len(t):
        return []
    place = np.floor(t / run.step + 1e-6).astype(int)
    near = np.clip(place[:, None] + np.array([-1, 0, 1, 2]), 0, len(run.t) - 1)
    found = []
    for name, ours in run.signals.items():
        if name not in results.signals:
            continue
        theirs = results.signals[name][within]
        band = max(OF_RANGE * np.ptp(theirs), OF_SIZE * np.abs(theirs).max(), LEAST)
        low, high = ours[near].min(axis=1), ours[near].max(axis=1)
        beyond = np.maximum(np.maximum(low - theirs, theirs - high), 0.0) / band
        worst = int(np.argmax(beyond))
        found.append(Deviation(name, float(beyond[worst]), float(t[worst])))
    return found
