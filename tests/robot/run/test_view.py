"""Runs that are read: what they have in common, and how a signal is held between its samples."""

import numpy as np

from tests.laws.runs import shipped
from twin.kernel.recording.reader import Recording
from twin.robot.run.trace import run_in_memory
from twin.robot.run.view import LogView, RunView, sample_and_hold


def test_a_sample_holds_until_the_next_one_and_rounding_of_times_does_not_count():
    log = LogView({"a.x": np.array([1.0, 2.0, 3.0])}, {"a": np.array([0.0, 0.1, 0.2])})
    t = np.array([-1.0, 0.0, 0.05, 0.1 - 1e-10, 0.1, 0.2 - 1e-3, 9.0])
    assert sample_and_hold(log, "a.x", t).tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0]


def test_a_run_in_memory_and_its_recording_read_alike(force_position: Recording):
    trace: RunView = run_in_memory(shipped("fig4_force_position"))
    recording: RunView = force_position
    assert recording.fields().keys() == trace.fields().keys()
    t = recording.time("plant")
    np.testing.assert_array_equal(trace.time("plant"), t)
    for key in ("controller.F_z", "plant.p_B", "scale.F_z", "controller.triggered"):
        np.testing.assert_array_equal(sample_and_hold(trace, key, t), sample_and_hold(recording, key, t))
        assert trace.fields()[key].size == recording.fields()[key].size


def test_a_log_knows_the_sizes_of_its_signals():
    log = LogView({"a.x": np.zeros(4), "a.y": np.zeros((4, 3))}, {"a": np.arange(4.0)})
    assert {key: field.size for key, field in log.fields().items()} == {"a.x": 1, "a.y": 3}
    assert log.metadata == {}
