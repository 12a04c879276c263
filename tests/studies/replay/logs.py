"""Runs of the twin that stand in for a robot, and their logs as a robot would write them."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import numpy as np

from twin.kernel.recording.logs.reader import recording_log
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
from twin.studies.replay.model import RobotModel, model_of
from twin.studies.replay.replay import Replay, replay_log

EXPERIMENTS = Path(__file__).resolve().parents[3] / "experiments"
FIG4 = "fig4_force_position"
NOISE = ("plant.motor_noise_deg=0.05", "plant.joint_noise_deg=0.02")
SCALE = ("scale.resolution_g=5", "scale.period_ms=10")
"""A scale under the body of a task, too."""

_RUNS = TemporaryDirectory()
"""Gone with this process."""


@cache
def ran(name: str, *settings: str) -> Recording:
    """A run of experiments/NAME.toml on a scale."""
    experiment = load_experiment(EXPERIMENTS / f"{name}.toml", [*SCALE, *settings])
    return read(execute(experiment, Path(mkdtemp(dir=_RUNS.name))).recording)


def healthy(name: str = FIG4) -> RobotModel:
    """The twin of the robot as it was built."""
    return model_of(load_experiment(EXPERIMENTS / f"{name}.toml", SCALE))


def judged(name: str, *settings: str, plant: bool = True) -> Replay:
    """A run with `settings` put through the twin of the robot without them."""
    return replay_log(recording_log(ran(name, *settings)), healthy(name), plant)


def softened(joints: Sequence[int], onset: float, factor: float = 0.9) -> str:
    """A setting that makes the springs of `joints` softer from `onset` (s) on."""
    table = "{{kind='spring_softened', target='joint_{}', onset_s={}, magnitude_factor={}}}"
    return "fault=[" + ", ".join(table.format(joint, onset, factor) for joint in joints) + "]"


def drifting(onset: float) -> str:
    """A setting that makes joint encoder 1 run away by 0.1 deg/s from `onset` (s) on."""
    return f"fault=[{{kind='encoder_drift', target='joint_encoder_1', onset_s={onset}, magnitude_deg_per_s=0.1}}]"


def write_log(path: Path, recording: Recording, keep: np.ndarray | None = None, angles: bool = False) -> Path:
    """A robot's CSV log with the encoders (or their angles in degrees) and the scale's reading as it stood.

    Args:
        path: of the file. recording: a run. keep: rows that were not lost (n,); None: all.
    """
    t = recording.time("encoder")
    if angles:
        head = [f"q_{side}{i} [deg]" for side in "ml" for i in (1, 2, 3)]
        values = np.degrees(np.hstack([recording["estimator.theta_m"], recording["estimator.theta_l"]]))
    else:
        head = [f"encoder.{name}[{i}]" for name in ("count_m", "count_l") for i in range(3)]
        values = np.hstack([recording["encoder.count_m"], recording["encoder.count_l"]])
    force = recording["scale.F_z"][np.searchsorted(recording.time("scale"), t, side="right") - 1]
    rows = np.column_stack([t, values, force])[slice(None) if keep is None else keep]
    lines = [",".join(["t_s", *head, "scale.F_z_N"]), *(",".join(map(repr, row)) for row in rows.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


ANGLES = [f"estimator.theta_{side}[{i - 1}]=q_{side}{i}[deg]" for side in "ml" for i in (1, 2, 3)]
"""The map of a log of angles."""
