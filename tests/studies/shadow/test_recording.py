"""Both sides of a session in one file."""

from pathlib import Path

import numpy as np

from twin.kernel.recording.reader import read
from twin.kernel.recording.sources.arrival import Arrival
from twin.kernel.recording.writer import ForeignTopic
from twin.robot.assembly.load import load_experiment
from twin.studies.replay.model import model_of
from twin.studies.replay.parts import FORCE_RESIDUAL, Happening
from twin.studies.shadow.recording import ShadowRecording


def test_what_is_found_out_late_or_logged_out_of_order_leaves_a_whole_recording(root: Path, tmp_path: Path):
    model = model_of(load_experiment(root / "experiments" / "fig4_force_position.toml"))
    joints = ForeignTopic("/joint_states", "cdr", "sensor_msgs/msg/JointState", "ros2msg", b"")
    path = tmp_path / "run.mcap"
    recording = ShadowRecording(path, {"residual/force": FORCE_RESIDUAL}, [joints], model, "robot", (0, 0))
    # a gap is known at the sample after it, an invalid sample at once
    for t, text in ((1.1, "no samples for 0.1 s"), (0.998, "24 samples with NaN"), (1.2, "late")):
        recording.event(Happening(t, text))
    for first, arrived in ((10, (20, 10, 30)), (50, (25, 40))):
        rows = {"residual/force": np.ones((1, 1))}
        recording.write([Arrival("/joint_states", t, b"data") for t in arrived], np.array([first]), rows)
    recording.finish({})
    events = read(path).events
    assert [(event.time, event.text) for event in events] == [
        (1.1, "no samples for 0.1 s"), (1.1, "24 samples with NaN"), (1.2, "late"),
    ]  # fmt: skip
