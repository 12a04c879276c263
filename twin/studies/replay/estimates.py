"""Position and force out of a log's counts, by the very estimator of a run."""

import numpy as np
from numpy.typing import NDArray

from twin.controller.belief import Belief
from twin.controller.estimator import Estimator, angle
from twin.cosim.playback import columns, play
from twin.recording.logs.errors import LogRefused
from twin.studies.replay.robot_log import RobotLog


def estimates(log: RobotLog, belief: Belief, gravity_compensation: bool) -> dict[str, NDArray[np.float64]]:
    """The estimator's outputs by port at every sample of `log`: (n,) or (n, size), SI.

    The component of a run is stepped; it keeps nothing from sample to sample but the last valid estimate, so a gap in
    the log costs the samples in it and no others.

    Raises:
        LogRefused: the first sample fits no pose of the robot, so there is nothing to hold.
    """
    component = Estimator(belief, gravity_compensation)
    rows, status = play(component, log.t, np.full(len(log.t), log.period), np.hstack([log.count_m, log.count_l]))
    if status:
        at = [np.degrees(angle(log.count_l[0, i], belief.joint_counts, belief.joint_zero[i])) for i in range(3)]
        raise LogRefused(
            f"{log.path}: the first joint angles ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) deg fit no pose of the robot; "
            "are their signs, units and zeros those of the experiment?"
        )
    return columns(component, rows)
