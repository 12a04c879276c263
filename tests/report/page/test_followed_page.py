"""The page of a session beside a robot: what it says is what the recording has."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.recording.forgery import data_records, sealed, with_metadata
from tests.studies.replay.logs import ANGLES, EXPERIMENTS, FIG4, ran, write_log
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read
from twin.report.page.markup import DataBlock
from twin.report.page.page import write_report
from twin.report.page.panels import scene
from twin.report.page.run import ReportRun
from twin.report.page.session_sections import even_samples, predicted_samples, session_verdict
from twin.studies.shadow import study
from twin.studies.shadow.alarm import CHANNELS, Tolerances

JUMP = "fault=[{kind='encoder_bias', target='joint_encoder_1', onset_s=3.0, magnitude_deg=0.3}]"
LIMITS = {500.0: Tolerances(dict.fromkeys(CHANNELS, 1e9) | {"spread": 0.3}, dict.fromkeys(CHANNELS, 0.01))}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_session(tmp_path_factory.mktemp("session"))


def recorded_session(folder: Path) -> Path:
    """Beside a robot whose encoder jumps at 3 s and that is silent from 5 to 5.5 s; two lines more are lost."""
    log = write_log(folder / "log.csv", ran(FIG4, JUMP), angles=True)
    head, *lines = log.read_text().splitlines()
    log.write_text("\n".join([head, *lines[:2500], *lines[2750:3000], *lines[3002:3500]]))
    with pytest.MonkeyPatch.context() as patched:
        # of a fleet, which takes minutes
        patched.setattr(study, "_limits", lambda *arguments: (LIMITS, ""))
        study.shadow(
            EXPERIMENTS / f"{FIG4}.toml", str(log), [*ANGLES, "scale.F_z=scale.F_z"], speed=0.0, fleet=folder,
            false_alarms_per_hour=1.0, out=folder / "session",
        )  # fmt: skip
    return folder / "session"


def cells(html: str, section: str) -> list[list[str]]:
    """Text of the rows of the tables in a section."""
    inside = html.partition(f'<section id="{section}"')[2].partition("</section>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", inside)
    return [[re.sub("<[^>]*>", "", cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in rows]


def test_the_page_has_residuals_alarms_with_evidence_gaps_and_punctuality(session: Path):
    answer = write_report([session])
    html = (session / "report.html").read_text()
    headline = str(answer.facts["headline"])
    assert re.fullmatch(r"Followed .*log\.csv for 7\.0 s, 1 alarm, the first at 3\.\d s", headline)
    recording = read(session)
    r = np.degrees(recording["residual/joints.theta_l"][:, 0])
    joint = next(row for row in cells(html, "followed") if row[0] == "joint 1, plant model less robot")
    assert joint[1:5] == [
        "deg", f"{np.mean(r):+.3g}", f"{np.sqrt(np.mean(r**2)):.3g}", f"{r[np.argmax(np.abs(r))]:+.3g}"
    ]  # fmt: skip
    (alarm,) = (row for row in cells(html, "alarms") if row[1] == "robot and twin diverge")
    facts = json.loads((session / "shadow.json").read_text())["alarm_states"]
    evidence = [f"{facts[0]['size']:+.3g} ", f"{facts[0]['since_s']:.3f} s", f"{facts[0]['level']:.2f}"]
    assert alarm[2:6] == ["spread", *evidence]
    found = cells(html, "gaps")
    assert ["missing", "252"] in found and ["gaps", "2"] in found
    assert found[-2:] == [["4.998 s", "0.502 s", "250"], ["5.998 s", "0.006 s", "2"]]
    assert ["0 to 0.1 ms", "3248", "100.00%", ""] in cells(html, "punctuality")
    # the same recording gives the same page
    write_report([session])
    assert (session / "report.html").read_text() == html


def test_of_a_session_that_was_killed_the_page_says_what_is_not_known(session: Path, tmp_path: Path):
    content = (session / "run.mcap").read_bytes()
    (tmp_path / "run.mcap.partial").write_bytes(content[: len(content) // 2])
    answer = write_report([tmp_path])
    html = (tmp_path / "report.html").read_text()
    assert "not to its end" in str(answer.facts["headline"])
    assert html.count("The session was interrupted, so this was not recorded.") == 3
    assert len(cells(html, "followed")) > 5


def test_where_samples_are_missing_a_curve_has_a_gap_and_goes_on_in_time(session: Path):
    run = ReportRun("", read(session))
    t = run.time("encoder")
    found = even_samples(lambda run: (t, t))(run)
    assert found is not None
    grid, values = found
    np.testing.assert_allclose(np.diff(grid), 0.002, rtol=0, atol=1e-9)
    missing = (grid > 4.999) & (grid < 5.499) | (grid > 5.999) & (grid < 6.003)
    assert np.array_equal(np.isnan(values), missing)
    np.testing.assert_allclose(values[~missing], grid[~missing], rtol=0, atol=1e-6)


def test_the_player_has_the_robot_by_its_counts_and_the_plant_model_over_it(session: Path):
    run, block = ReportRun("", read(session)), DataBlock()
    shown = scene(run, block, robot="estimator", model="plant")
    assert shown is not None
    frames, first = shown["frames"], shown["frames"]["second"]
    columns = np.frombuffer(block.content(), "<f4").reshape(-1, frames["count"])
    t = frames["start"] + frames["step"] * np.arange(frames["count"])
    assert len(columns) == first + 12
    for column, key in ((9, "estimator.p_B"), (first + 9, "plant.p_B")):
        np.testing.assert_allclose(columns[column : column + 3].T, 1e3 * run.values_at(key, t), rtol=1e-6, atol=1e-5)
    # where the encoder has jumped the two part: 0.3 deg of a link of 50 mm and more
    parted = np.linalg.norm(columns[first : first + 3] - columns[:3], axis=0)
    assert np.median(parted[t > 3.5]) > 0.25 > 0.1 > np.median(parted[(t > 1.0) & (t < 3.0)])


@pytest.mark.parametrize(
    ("kind", "states", "good"), [("diverge", None, False), ("diverge", [], False), ("not watched", None, None)]
)
def test_the_page_has_the_verdict_of_a_session_without_an_alarm(
    session: Path, tmp_path: Path, kind: str, states: list[object] | None, good: bool | None
):
    text = "the last word of the session"

    def judged(name: str, entries: dict[str, str]) -> dict[str, str]:
        facts = {"alarm_states": states, "verdict": kind, "verdict_text": text}
        return {"facts": json.dumps(json.loads(entries["facts"]) | facts)} if name == "followed" else entries

    sealed(with_metadata(data_records(session / "run.mcap"), judged), tmp_path / "run.mcap")
    verdict = session_verdict([ReportRun("", read(tmp_path))])
    assert verdict.headline.endswith(text) and verdict.good is good


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("counts", {"samples": -1}, "counts.samples"),
        ("clock_drift", float("inf"), "clock_drift"),
        ("notes", 3, "notes"),
    ],
)
def test_facts_that_are_damaged_are_refused_in_a_sentence(
    session: Path, tmp_path: Path, key: str, value: object, place: str
):
    def forged(name: str, entries: dict[str, str]) -> dict[str, str]:
        facts = {"facts": json.dumps(json.loads(entries["facts"]) | {key: value})} if name == "followed" else entries
        return facts

    change: Callable[[str, dict[str, str]], dict[str, str]] = forged
    sealed(with_metadata(data_records(session / "run.mcap"), change), tmp_path / "run.mcap")
    with pytest.raises(InputRefused, match=f"its session results are damaged: {place}: "):
        write_report([tmp_path])


def test_a_session_is_not_judged_beside_a_run_whose_truth_is_known(session: Path):
    with pytest.raises(InputRefused, match="records a run, and another one a session with a robot; write a page for"):
        write_report([session, ran(FIG4).path])


def test_a_session_has_no_accuracy_budget(session: Path):
    with pytest.raises(InputRefused, match="records a session, whose true force is not known; leave --budget out"):
        write_report([session], budget=True)


def test_of_predictions_the_later_halves_are_drawn_one_after_the_other_with_a_gap_where_there_was_none():
    made = np.array([0.5, 1.0, 2.0])
    values = made[:, None] + 0.05 * np.arange(1, 21)

    class Session:
        def has(self, *keys: str) -> bool:
            return set(keys) <= {"ahead.made", "ahead.F_z"}

        def column(self, key: str, column: int | None) -> np.ndarray:
            return made if key == "ahead.made" else values

    assert predicted_samples("p_z")(Session()) is None  # type: ignore[arg-type]
    drawn = predicted_samples("F_z")(Session())  # type: ignore[arg-type]
    assert drawn is not None
    t, found = drawn
    np.testing.assert_allclose([t[0], t[-1]], [1.05, 3.0])
    there = np.isfinite(found)
    assert np.sum(there) == 30
    np.testing.assert_allclose(found[there], t[there])
