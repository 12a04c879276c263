import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.recording import samples
from tests.kernel.recording.forgery import data_records, sealed, without_last
from tests.studies.paper.fig5_recordings import pressed
from twin.kernel.recording.reader import Recording, read
from twin.report.page.page import report_page, verdict_section, write_report
from twin.report.page.panels import commanded_speed
from twin.report.page.run import ReportRun
from twin.report.page.verdict import verdict
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def page(force_position: Recording) -> str:
    return report_page([ReportRun("fig4", force_position)])[0]


def data_of(page: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found[1])


def test_the_verdict_comes_before_everything_else(page: str):
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", page)
    assert titles[:2] == ["Verdict", "Replay"]
    assert "5 of 5 claims hold" in page[: page.index("Replay</h2>")]


def test_three_numbers_of_what_truly_happened_stand_beside_the_verdict(page: str, force_position: Recording):
    first = page[: page.index("Replay</h2>")]
    boxes = re.findall(r'<div class="box"><strong>([^<]*)</strong><span>([^<]*)</span></div>', first)
    assert [name for _, name in boxes] == ["force error", "largest pressing force", "settling"]
    assert boxes[1][0] == f"{-force_position['plant.F_ee_B'][:, 2].min():.4g} N"


def test_of_several_runs_the_same_three_numbers_stand_side_by_side(force_position: Recording, position: Recording):
    runs = [ReportRun("fp", force_position), ReportRun("p", position)]
    names = re.findall(r"</strong><span>([^<]*)</span>", verdict_section(runs, verdict(runs)))
    # without a force loop there is no force error
    assert names == 2 * ["largest pressing force", "settling", "settled force error"]


def test_of_several_runs_each_has_its_numbers_and_of_many_none(force_position: Recording):
    runs = [ReportRun(f"run {number}", force_position) for number in range(5)]
    two, many = (verdict_section(some, verdict(some)) for some in (runs[:2], runs))
    assert two.count('class="box"') == 6 and two.count('class="whose"') == 2
    assert 'class="box"' not in many


def test_the_same_recording_gives_the_same_page(page: str, force_position: Recording):
    assert report_page([ReportRun("fig4", read(force_position.path))])[0] == page


def test_nothing_is_loaded_from_elsewhere(page: str):
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    # the filter that stands in the page itself
    assert not re.findall(r"url\((?!#dark\))", page) and "@import" not in page
    assert page.count('id="dark"') == 1
    assert "default-src 'none'" in page


def test_a_report_of_20_s_at_1_kHz_stays_below_8_MB(page: str):
    assert len(page.encode()) < 8e6


def test_a_run_that_lost_an_estimate_has_a_page_without_the_picture_that_needs_it(
    page: str, force_position: Recording, tmp_path: Path
):
    drawn = 'alt="Laid out like Fig. 4'
    assert drawn in page
    lost = sealed(without_last(data_records(force_position.path), "/estimator"), tmp_path / "run.mcap")
    assert drawn not in report_page([ReportRun("fig4", read(lost))])[0]


def test_titles_and_texts_cannot_become_markup(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.1", f"title={EVIL}"])
    page = report_page([ReportRun(EVIL, read(execute(experiment, tmp_path).recording))])[0]
    assert page.count("<script") == 2 and page.count("</script>") == 2
    assert "<img src=x" not in page
    assert f"<h1>{EVIL}</h1>" in unescape(page)
    assert data_of(page)["runs"][0]["label"] == EVIL


def test_panels_show_truth_beside_belief(page: str):
    panels = {panel["title"]: panel for panel in data_of(page)["panels"]}
    roles = {row["role"] for row in panels["Pressing force F_z"]["rows"]}
    assert roles >= {"truth", "belief", "reference"}
    assert {row["label"] for row in panels["Motor speed"]["rows"]} >= {"commanded 1", "true 3"}


def test_the_commanded_speed_is_what_reaches_the_drives(root: Path, tmp_path: Path):
    late = ["duration_s=0.1", "controller.bus_delay_ticks=20"]
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", late)
    run = ReportRun("", read(execute(experiment, tmp_path).recording))
    samples = commanded_speed(1)(run)
    assert samples is not None
    assert np.array_equal(samples[1], run.recording["bus.omega_ref"][:, 1])
    assert not np.array_equal(samples[1][::2], run.recording["controller.omega_ref"][:, 1])


def test_what_a_drive_says_of_its_own_has_a_panel(root: Path, tmp_path: Path):
    experiment = load_experiment(
        root / "experiments/fig4_force_position.toml", ["duration_s=0.1"], str(root / "fmus/pmsm_foc")
    )
    page = report_page([ReportRun("", read(execute(experiment, tmp_path).recording))])[0]
    assert "Drives: current" in [panel["title"] for panel in data_of(page)["panels"]]


def test_several_runs_are_laid_over_each_other_with_what_differs(force_position: Recording, position: Recording):
    page = report_page([ReportRun("with", force_position), ReportRun("without", position)])[0]
    assert "28 of 34 claims hold, 6 not reproduced" in page
    assert '<th scope="row">controller.mode</th><td></td><td>force_position</td><td>position</td>' in page
    for panel in data_of(page)["panels"]:
        assert all(len(row["curves"]) == 2 for row in panel["rows"])


def test_an_unfinished_run_says_so_first(root: Path, tmp_path: Path):
    path = samples.unfinished(tmp_path / "run.mcap")
    page, headline = report_page([ReportRun("sample", read(path))])
    assert headline.startswith("Unfinished recording: read up to 1.4")
    assert "✗ Unfinished recording" in page


def test_runs_that_hold_less_than_a_robot_are_shown_as_far_as_they_go(tmp_path: Path):
    page, _ = report_page([ReportRun("press", pressed(tmp_path))])
    assert "there is no player" in page
    assert data_of(page)["scenes"] == [None]


def test_samples_that_are_no_numbers_are_left_out_of_the_data(tmp_path: Path):
    F_z = pressed(tmp_path)["plant.F_ee_B"]
    assert np.all(np.isfinite(F_z))
    page, _ = report_page([ReportRun("sample", read(samples.finished(tmp_path / "sample.mcap")))])
    assert "NaN" not in json.dumps(data_of(page))


def test_the_page_lands_beside_its_recording(tmp_path: Path):
    pressed(tmp_path)
    assert Path(write_report([tmp_path]).facts["page"]) == tmp_path / "report.html"
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")


def test_numbers_that_json_does_not_know_are_null_in_the_page(
    force_position: Recording, monkeypatch: pytest.MonkeyPatch
):
    run = ReportRun("", force_position)
    height = run.values["contact"] | {"height_mm": 1e308, "tilt_deg": 45.0, "radius_mm": 1e308, "shape": "sphere"}
    monkeypatch.setitem(run.values, "contact", height)
    page, _ = report_page([run])
    assert re.search(r"\"surface\":\[[^\"]*null", page)
