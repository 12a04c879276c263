"""Comparison of the commands of a robot and of its twin's controller, until the two controllers diverge.

The force loop begins with a single sample, the first that exceeds its trigger. If samples were lost before, the twin's
controller may begin it earlier or later than the robot's, since its filtered force is another one. From then on the two
differ for good, although the robot is healthy.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import port_slices
from twin.robot.controller.controller import LAW_OUTPUTS
from twin.robot.experiment.experiment import Experiment
from twin.studies.replay.parts import Rows

MAX_AGREEMENT = 0.05
"""Largest command difference (rad/s) of controllers at the same point; when one has begun its force loop it is 0.4."""
MAX_PARTING = 0.05
"""Time (s) that the commands may differ around the trigger; longer means different points."""
TRIGGER_SPAN = 2.0 * MAX_PARTING
"""Time span (s) after the trigger of the twin's controller in which large differences are left out."""
MIN_LOST = 1.5
"""Smallest number of lost samples that may change the trigger; errors of stamps count as less than one sample."""
MIN_TOLERANCE = 0.01
"""Smallest tolerance of a block's mean (rad/s). A force loop that begins `MAX_PARTING` later has another integral, in
Fig. 4 by 0.004 rad/s; lost samples add 0.0005 at 500 Hz and 0.003 at 100 Hz."""
_TRIGGERED = port_slices(LAW_OUTPUTS)["triggered"].start


class CommandComparison:
    """Largest command difference of robot and twin at each sample, fed in slices of any length.

    NaN where it comes from the trigger of the force loop, and for good once the controllers are at different points.

    Args:
        twin: experiment of the twin, whose controller is the experiment's own.
    """

    def __init__(self, twin: Experiment):
        self._period = twin.controller_ticks * twin.cosim.tick
        self._begin, self._count = math.nan, 0
        self._trigger, self._agreed, self._apart = math.inf, math.nan, False

    def feed(self, t: NDArray[np.float64], rows: Rows) -> Rows:
        """Return "residual_command" (n,), rad/s, at the times `t` (n,), s, from the rows of an `OwnController`."""
        residual = np.abs(rows["residual/command"]).max(axis=1)
        force_on = rows["controller"][:, _TRIGGERED] > 0.0
        if math.isnan(self._begin):
            self._begin = self._agreed = float(t[0])
        if math.isinf(self._trigger) and force_on.any():
            self._trigger = float(t[force_on][0])
        agreed = np.maximum.accumulate(np.where(residual <= MAX_AGREEMENT, t, self._agreed))
        differs = (residual > MAX_AGREEMENT) & (t < self._trigger + TRIGGER_SPAN)
        lost = (t - self._begin) / self._period - (self._count + np.arange(len(t)))
        parted = differs & (t - agreed > MAX_PARTING) & (lost > MIN_LOST)
        apart = np.logical_or.accumulate(parted) | self._apart
        residual[differs | apart] = math.nan
        self._agreed, self._apart, self._count = float(agreed[-1]), bool(apart[-1]), self._count + len(t)
        return {"residual_command": residual}


def comparison_of(twin: Experiment) -> CommandComparison | None:
    """Return the comparison of commands for a twin.

    None for a third-party controller, and for a sequence of tasks, whose state depends on single samples.
    """
    return None if twin.reference is None or "controller" in twin.stand_ins else CommandComparison(twin)
