"""Stiffness of the springs alone, from measured torques of the motors."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import Log, LogError
from twin.robot.controller.controller import Belief
from twin.studies.identify.balance import deflections, subtract_dead_zone
from twin.studies.identify.clustered import line
from twin.studies.identify.estimate import Estimate
from twin.studies.identify.fit import Fit
from twin.studies.identify.parameters import BACKLASH
from twin.studies.identify.windows import Windows


def spring_stiffness(springs: Fit, belief: Belief, log: Log) -> Estimate | None:
    """Estimate k_s (N m/rad) from drive/1.tau_motor to drive/3.tau_motor; None if the torque does not vary."""
    seen = springs.seen
    torque = np.stack([_mean(log, f"drive/{i}.tau_motor", seen) for i in (1, 2, 3)], axis=1).ravel()

    def equations(x: NDArray[np.float64]) -> NDArray[np.float64]:
        A = np.zeros((3 * len(seen.t), 7))
        A[:, 0] = subtract_dead_zone(deflections(x, seen, belief.N), x[BACKLASH]).ravel()
        for i in range(3):
            A[i::3, 1 + i] = np.sign(seen.speed[:, i])
            A[i::3, 4 + i] = 1.0
        return A

    found = line(equations(springs.x), torque, np.repeat(seen.cluster, 3))
    if found is None:
        return None
    through = springs.half_width_through(lambda x: float(np.linalg.pinv(equations(x))[0] @ torque))
    return Estimate(float(found.coefficients[0]), float(np.hypot(found.half_widths[0], through)), "N m/rad")


def _mean(log: Log, name: str, seen: Windows) -> NDArray[np.float64]:
    if name not in log.series:
        raise LogError(
            f"{log.path}: '{name}' is not there; --motor-torque needs the torques of all three motors: choose with "
            f"--map {name}=COLUMN[N m]"
        )
    series = log.series[name]
    if series.unit != "N m":
        raise LogError(f"{log.path}: {name} is in '{series.unit}', expected 'N m'; a current is not a torque")
    total = np.concatenate([[0.0], np.cumsum(series.values)])
    first = np.searchsorted(series.t, seen.t - 0.5 * seen.length)
    last = np.maximum(np.searchsorted(series.t, seen.t + 0.5 * seen.length), first + 1)
    last = np.minimum(last, len(series.t))
    return (total[last] - total[first]) / np.maximum(last - first, 1)
