"""Measures of a log: of the measured force, with the reference of the twin's own controller."""

from dataclasses import replace

import numpy as np
import pytest

from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.reader import Recording
from twin.studies.replay.held import LOG_MEASURES, log_measures, measures_text
from twin.studies.replay.model import model_for
from twin.studies.replay.replay import Replay, replay_log


@pytest.fixture(scope="module")
def replay(force_position: Recording) -> Replay:
    return replay_log(read_log(force_position.path), model_for(force_position.path, None))


def test_a_log_holds_its_measured_force_at_the_reference_of_the_twin_s_controller(
    force_position: Recording, replay: Replay
):
    found = log_measures(replay.log, replay.estimator, None, ())
    assert set(found) == set(LOG_MEASURES)
    # by hand: 2 s from the first touch with the loop on, the scale's samples, 5 N asked for
    t, F_z = force_position.time("scale"), force_position["scale.F_z"]
    on = force_position.time("controller")[np.flatnonzero(force_position["controller.triggered"])[0]]
    start = t[(t >= on) & (np.maximum.accumulate(F_z) > 0.0)][0]
    held = F_z[t >= start + 2.0 - 1e-9] - 5.0
    assert found["hold_error"].value == pytest.approx(np.sqrt(np.mean(held**2)), rel=1e-9)
    assert found["hold_mean_error"].value == pytest.approx(held.mean(), rel=1e-9)
    # the true force is off by 0.094 N, and the scale has steps of 0.05 N; the estimate would say 0.036 N
    assert found["hold_error"].value == pytest.approx(0.094, abs=0.01)
    assert measures_text(found) == "hold error 0.088 N, overshoot 0.0 %, settling time 0.83 s; of the measured force"


def test_a_log_without_a_force_has_no_measures_but_the_reason(replay: Replay):
    found = log_measures(replace(replay.log, force=None), replay.estimator, None, ())
    assert {one.value for one in found.values()} == {None}
    assert measures_text(found) == "none: the log has no force"
