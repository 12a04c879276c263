"""The plant beside the robot: driven by the log's motor angles, what would springs, mechanism and body have done?

The model is the component of a run. At the end of each of its steps the motor is where the line between the two
neighbouring samples has it, which is what a drive hands the plant in a run (docs/cosim.md: the plant sees the motor
angle of the end of the step).
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.playback import columns, play
from twin.kernel.errors import ComponentFailed
from twin.kernel.recording.logs.log import LogRefused
from twin.robot.plant.component import OUTPUTS, Plant
from twin.robot.plant.contact_law import Body
from twin.robot.plant.dynamics import STATES
from twin.studies.replay.model import RobotModel

LONGEST_GAP = 0.1
"""s. A line across more than this is no motor's way: several periods of the springs' slowest free motion, 75 rad/s."""
SETTLING = 1.0
"""s, before each start, with the motors where the first sample has them: 20 time constants of the springs' swing with
the robot's joint friction, and 5 of a robot with a quarter of it."""


def motions(
    model: RobotModel, t: NDArray[np.float64], theta_m: NDArray[np.float64], p_B: NDArray[np.float64]
) -> tuple[dict[str, NDArray[np.float64]], list[float]]:
    """What the plant model does under the motor angles of a log.

    It starts at rest, settled, where the log's first sample has the robot; and again after every gap longer than
    `LONGEST_GAP`. What friction held before is forgotten then.

    Args:
        model: the twin.
        t: times of the samples (n,), s, ascending.
        theta_m: motor angles (n, 3), rad.
        p_B: the robot's position by its encoders (n, 3), m, for the starts.

    Returns:
        The plant's outputs by port at every sample, (n,) or (n, size), SI; and the times (s) of all starts.

    Raises:
        LogRefused: samples too far apart to know the motors' way.
        ComponentFailed: the model left the workspace.
    """
    if np.median(np.diff(t)) > LONGEST_GAP:
        raise LogRefused(
            f"a sample every {np.median(np.diff(t)):.3g} s; the plant model needs one every {LONGEST_GAP:g} s or sooner"
        )
    bounds = [0, *(np.flatnonzero(np.diff(t) > LONGEST_GAP) + 1), len(t)]
    parts = [_stretch(model, t[a:b], theta_m[a:b], p_B[a]) for a, b in pairwise(bounds)]
    joined = {port.name: np.concatenate([part[port.name] for part in parts]) for port in OUTPUTS}
    return joined, [float(t[a]) for a in bounds[:-1]]


def _stretch(
    model: RobotModel, t: NDArray[np.float64], theta_m: NDArray[np.float64], p_B: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """The plant's outputs at the samples of a stretch without long gaps."""
    x = np.zeros(STATES)
    x[:3] = p_B
    plant = Plant(model.plant, x, theta_m[0], model.substeps, bool(model.motions))
    # settling first, so that the sample is what the model starts from
    before = int(np.ceil(SETTLING / model.tick))
    steps = np.array([before, *np.maximum(1, np.ceil(np.diff(t) / model.tick - 1e-6))], dtype=np.int64)
    lengths = np.array([SETTLING, *np.diff(t)])
    h = np.repeat(lengths / steps, steps)
    ends = t[0] - SETTLING + np.cumsum(h)
    u = np.stack([np.interp(ends, t, theta_m[:, i]) for i in range(3)], axis=1)
    if model.motions:
        ground, _ = play(Body(model.motions), ends - h, h, np.empty((len(h), 0)))
        ground[:before] = [*ground[before - 1][:3], 0.0, 0.0, 0.0]
        u = np.hstack([u, ground])
    rows, status = play(plant, ends - h, h, u, steps)
    if status:
        raise ComponentFailed(
            f"the plant model, driven by the log's motor angles, {plant.explain(status)} before "
            f"t = {t[len(rows)]:.3f} s; does the experiment describe this robot?"
        )
    return columns(plant, rows)
