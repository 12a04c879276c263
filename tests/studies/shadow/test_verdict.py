"""The verdict of a session: what parts robot and twin, and which times were not watched."""

import pytest

from twin.studies.shadow.ahead import PredictionScore
from twin.studies.shadow.alarm import WatchEvent, WatchState
from twin.studies.shadow.text import shadow_result
from twin.studies.shadow.verdict import SessionSummary, verdict_of

SILENT = "no sample for 2 s: no message has m2"
LOST = WatchEvent(10.0, WatchState.NOT_WATCHED, found=SILENT)
BACK = WatchEvent(16.5, WatchState.LISTENING)
COOLING = WatchEvent(30.0, WatchState.COOLING_DOWN, found="a new reference is learnt")
AGAIN = WatchEvent(40.0, WatchState.LISTENING)
OTHER = WatchEvent(50.0, WatchState.NOT_WATCHED, found="the robot is sampled at 167 Hz")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ([], ""),
        ([LOST, BACK], " (not watched for up to 7 s)"),
        # a silence while the alarm learns another rate
        ([COOLING, LOST, COOLING, AGAIN], " (not watched for up to 10 s)"),
        ([LOST], f" until 10.0 s, then not watched: {SILENT}"),
        (
            [LOST, BACK, OTHER],
            " (not watched for up to 7 s) until 50.0 s, then not watched: the robot is sampled at 167 Hz",
        ),
    ],
)
def test_a_robot_that_matches_is_told_how_long_it_was_not_watched(changes: list[WatchEvent], text: str):
    verdict = verdict_of(SessionSummary("robot", seconds=60.0, changes=changes))
    assert (verdict.kind, verdict.text) == ("match", f"robot and twin match{text}")


@pytest.mark.parametrize(("banded", "within", "kind"), [(200, 39, "diverge"), (200, 40, "match"), (199, 0, "match")])
def test_forces_far_outside_their_band_part_robot_and_twin(banded: int, within: int, kind: str):
    summary = SessionSummary("robot", changes=[], ahead=PredictionScore(10, banded, within))
    assert verdict_of(summary).kind == kind and shadow_result(summary, "fig4", {}).exit_code == (kind == "diverge")


@pytest.mark.parametrize(("caution", "is_failure"), [("", True), ("this robot was not identified yet", False)])
def test_a_band_of_a_robot_that_was_not_identified_is_no_failure(caution: str, is_failure: bool):
    summary = SessionSummary("robot", changes=[], ahead=PredictionScore(10, 200, 136), caution=caution)
    text = " ".join(shadow_result(summary, "fig4", {}).text.split())
    assert "68 % of the estimated forces lay in the band" in text
    assert ("95 % is promised of identified robots only" in text) is not is_failure
