import json
import re
import shlex
from dataclasses import replace
from html import unescape
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.recording import samples
from tests.kernel.recording.forgery import data_records, sealed, without_last
from tests.studies.paper.fig5_recordings import pressed
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.reader import recording_log
from twin.kernel.recording.reader import Recording, read
from twin.report.page.page import (
    command,
    differences,
    drives,
    provenance,
    report_page,
    source,
    verdict_section,
    write_report,
)
from twin.report.page.panels import commanded_speed
from twin.report.page.run import ReportRun, report_runs
from twin.report.page.verdict import verdict
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import load_experiment, recorded_experiment
from twin.robot.experiment.differences import flatten, name_and_unit
from twin.robot.run.run import SUMMARY_FILE, execute
from twin.studies.accuracy.budget import NOT_MODELLED, Budget, Contribution, accuracy_budget

BUDGET = Budget(
    name="fig4",
    start=6.5,
    end=20.0,
    force=4.91,
    contributions=(
        Contribution("encoder counts", 0.0044, 0.0313, 0.0316, "encoders as they are", "imperfection"),
        Contribution("backlash <b>", 0.1131, 0.0381, 0.1194, "backlash as it is", "imperfection"),
        Contribution("coupling", -1e-6, 0.0002, 0.0002, "the twin's error", "twin"),
        Contribution("k_s +2 %", 0.0555, 0.0003, 0.0555, "two fits differ by this much", "parameter"),
    ),
    bias=0.1175,
    together=0.1235,
    parameters=0.0555,
    as_is=Contribution("as it is", 0.1138, 0.0497, 0.1242, "estimated less true force", "total"),
)


def rows(page: str) -> dict[str, list[str]]:
    """Cells of the tables of the section, by the first."""
    section = page.partition('<section id="accuracy"')[2].partition("</section>")[0]
    lines = re.findall(r'<tr><th scope="row">(.*?)</th>(.*?)</tr>', section)
    return {unescape(name): re.findall(r"<td>(.*?)</td>", cells) for name, cells in lines}


def test_every_cause_has_its_newtons_and_the_sum_stands_above_the_whole(force_position: Recording):
    page, _ = report_page([ReportRun("fig4", force_position)], [BUDGET])
    found = rows(page)
    assert [name for name in found if name != "all of them"] == [
        "encoder counts",
        "backlash <b>",
        "as it is",
        "coupling",
        *(what for what, _, _ in NOT_MODELLED),
        "k_s +2 %",
    ]
    assert found["backlash <b>"] == ["+0.1131", "0.0381", "0.1194", "backlash as it is"]
    assert found["as it is"] == ["+0.1138", "0.0497", "0.1242", "estimated less true force"]
    # less than is shown has no sign of its own
    assert found["coupling"][0] == "+0.0000"
    assert "The force is estimated to 0.124 N rms. Pressing 4.91 N" in page
    assert '<a href="#accuracy">Accuracy budget</a>' in page


def test_the_budget_needs_no_script(force_position: Recording):
    pages = [report_page([ReportRun("fig4", force_position)], budgets)[0] for budgets in ((), [BUDGET])]
    assert [page.count("<script") for page in pages] == [2, 2]
    assert pages[0].partition("<script")[2] == pages[1].partition("<script")[2]
    assert "Accuracy budget" not in pages[0]


def test_each_of_several_runs_has_its_own_budget(force_position: Recording, position: Recording):
    runs = [ReportRun("with", force_position), ReportRun("without", position)]
    page, _ = report_page(runs, [BUDGET, BUDGET])
    assert page.count("causes of the force error of with") == 2
    assert "causes of the force error of without" in page


@pytest.mark.slow
def test_a_budget_is_made_of_the_experiment_as_it_was_recorded(root: Path, tmp_path: Path):
    settings = ["duration_s=8", "plant.backlash_deg=0.2"]
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", settings)
    execute(experiment, tmp_path)
    told: list[str] = []
    page = Path(
        write_report([tmp_path], None, True, lambda what, share=None: told.append(what)).facts["page"]
    ).read_text()
    budget = accuracy_budget(experiment)
    assert rows(page)["backlash"][2] == f"{budget.contributions_of('imperfection')[1].rms:.4f}"
    assert rows(page)["as it is"][2] == f"{budget.as_is.rms:.4f}"
    assert told[:2] == [f"fig4_force_position: {name}, {n} of 27" for n, name in ((1, "as it is"), (2, "ideal"))]


def test_a_run_without_force_has_no_budget(root: Path, tmp_path: Path):
    execute(load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.1"]), tmp_path)
    with pytest.raises(InputRefused, match=r"^fig4_force_position: presses with 0\.5 N at most"):
        write_report([tmp_path], budget=True)
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("key", "name", "unit"),
    [
        ("controller.force.kp_mm_per_N", "controller.force.kp", "mm/N"),
        ("controller.force.ki_mm_per_N_s", "controller.force.ki", "mm/(N s)"),
        ("controller.position.kp_per_s", "controller.position.kp", "1/s"),
        ("plant.k_s_Nm_per_rad", "plant.k_s", "N m/rad"),
        ("robot.I_r_kg_m2", "robot.I_r", "kg m²"),
        ("robot.N", "robot.N", ""),
        ("robot.m_p_g", "robot.m_p", "g"),
        ("duration_s", "duration", "s"),
        ("contact.friction", "contact.friction", ""),
        ("fault.1.magnitude_rad_per_s", "fault.1.magnitude", "rad/s"),
        ("drive.parameters.T_s", "drive.parameters.T_s", ""),
    ],
)
def test_the_unit_is_read_from_the_key(key: str, name: str, unit: str):
    assert name_and_unit(DECLARED_TABLES, key) == (name, unit)


def test_every_value_of_a_run_has_a_source(force_position: Recording):
    run = ReportRun("fig4", force_position)
    without = [key for key, _ in flatten(run.values) if not source(key, run.origins)]
    assert without == []
    assert source("plant.k_s_Nm_per_rad", run.origins).startswith("robot: Sec. III.A")


def test_only_what_differs_is_a_difference(force_position: Recording, position: Recording):
    runs = [ReportRun("a", force_position), ReportRun("b", position)]
    assert differences(runs) == [("controller.mode", "", "force_position", "position")]
    assert differences([runs[0], ReportRun("c", force_position)]) == []


def settings_of(words: list[str]) -> list[str]:
    return [word for option, word in pairwise(words) if option == "--set"]


@pytest.mark.parametrize(
    "settings",
    [
        ["duration_s=0.1"],
        ["duration_s=0.1", "controller.force.kp_mm_per_N=3", "title=it's <b>mine</b>"],
        ["duration_s=0.1", 'fault=[{kind="drive_runaway", onset_s=0.05, magnitude_rad_per_s=2.0}]'],
    ],
)
def test_the_command_makes_the_same_recording_again(root: Path, tmp_path: Path, settings: list[str]):
    path = root / "experiments/fig4_force_position.toml"
    folders = [tmp_path / "first", tmp_path / "again"]
    for folder in folders:
        folder.mkdir()
    first = execute(load_experiment(path, settings), folders[0]).recording
    words = shlex.split(command(ReportRun("", read(first))))
    assert words[:3] == ["twin", "run", str(path)]
    again = execute(load_experiment(words[2], settings_of(words)), folders[1]).recording
    assert again.read_bytes() == first.read_bytes()
    # without the summary beside it a recording knows the name only
    first.with_name("summary.json").unlink()
    words = shlex.split(command(ReportRun("", read(first))))
    assert words[:3] == ["twin", "run", "fig4_force_position"]
    assert (
        execute(load_experiment(words[2], settings_of(words)), folders[1]).recording.read_bytes() == first.read_bytes()
    )


class Idle:
    """A controller that never moves."""

    sampled = True

    def __init__(self, original: Component):
        self.inputs, self.outputs = original.inputs, original.outputs

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[:] = 0.0


@pytest.fixture(scope="module")
def substituted(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with a controller of somebody's own."""
    experiment = load_experiment(root / "experiments/fig4_position.toml", ["duration_s=0.1"])
    with assemble(experiment) as own:
        model = Idle(next(c for c in own.system.components if c.name == "controller"))
    mine = PythonComponent("controller", model, experiment.controller_ticks)
    folder = tmp_path_factory.mktemp("substituted")
    execute(experiment, folder, substitutes={"controller": mine})
    return folder


def test_a_substitute_is_named_wherever_the_run_is_told_of(substituted: Path):
    assert json.loads((substituted / SUMMARY_FILE).read_text())["substituted"] == {
        "controller": "Idle (PythonComponent)"
    }
    recording = read(substituted / "run.mcap")
    assert recording.metadata["substituted"] == {"controller": "Idle (PythonComponent)"}
    said = "controller was substituted by Idle (PythonComponent): the experiment alone does not repeat this run"
    assert recording.deviations == (said,)
    assert said in recording_log(recording).notes
    page, _ = report_page(report_runs([substituted]))
    assert said in page
    assert f"C{said[1:]}." in page


def test_a_run_with_a_substitute_is_not_promised_to_come_again(substituted: Path, force_position: Recording):
    promise = "byte for byte"
    assert promise in provenance(ReportRun("", force_position))
    run = ReportRun("", read(substituted / "run.mcap"))
    assert promise not in provenance(run)
    assert "command of its experiment" in provenance(run)
    with pytest.raises(InputRefused, match="was made with a substitute for controller"):
        recorded_experiment(run.recording.metadata, run.recording.path)


def test_a_run_that_was_changed_by_hand_is_not_promised_to_come_again_either(force_position: Recording):
    changed = replace(force_position, metadata=force_position.metadata | {"changed": {"first": "x"}})
    told = provenance(ReportRun("", changed))
    assert "byte for byte" not in told
    assert "Changed by hand while it ran" in told


def test_an_fmu_that_was_substituted_is_not_said_to_have_run(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_position.toml", ["duration_s=0.1"])
    with assemble(experiment) as own:
        model = Idle(next(c for c in own.system.components if c.name == "drive_2"))
    model.sampled = False
    run = execute(experiment, tmp_path, substitutes={"drive_2": PythonComponent("drive_2", model)})
    assert read(run.recording).metadata["fmu"].keys() == {"drive_1", "drive_3"}
    assert len(run.drives) == 2


def test_a_substitute_without_a_place_is_refused(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_position.toml", ["duration_s=0.1"])
    with pytest.raises(InputRefused, match="no component 'contoller' in this experiment; did you mean 'controller'"):
        execute(experiment, tmp_path, substitutes={"contoller": None})  # type: ignore[dict-item]


def test_the_page_says_how_much_of_the_robot_is_assumed(page: str):
    assert "<p>The robot has 0 own values, 18 inherited assumptions; twin accuracy ranks them.</p>" in page


def test_another_drive_and_another_body_are_in_the_command(root: Path, tmp_path: Path):
    path = root / "experiments/fig4_force_position.toml"
    experiment = load_experiment(path, ["duration_s=0.1"], str(root / "fmus/pmsm_foc"), "back")
    recording = execute(experiment, tmp_path).recording
    others = "--body back --set duration_s=0.1"
    assert command(ReportRun("", read(recording))) == f"twin run {path} --drive {root}/fmus/pmsm_foc {others}"
    recording.with_name("summary.json").unlink()
    assert command(ReportRun("", read(recording))) == f"twin run fig4_force_position --drive pmsm_foc {others}"


def test_drives_that_are_alike_are_told_once_with_their_hash(force_position: Recording):
    run = ReportRun("", force_position)
    told = drives(run)
    assert told.count(run.fmus["drive_1"]["sha256"]) == 1
    assert ">1, 2, 3<" in told
    assert json.loads(force_position.metadata["fmu"]["drive_3"]) == run.fmus["drive_3"]


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
    assert "5 of 5 of this run&#x27;s own checks hold" in page[: page.index("Replay</h2>")]


def test_four_numbers_of_what_truly_happened_stand_beside_the_verdict(page: str, force_position: Recording):
    first = page[: page.index("Replay</h2>")]
    boxes = re.findall(r'<div class="box"><strong>([^<]*)</strong><span>([^<]*)</span></div>', first)
    assert [name for _, name in boxes] == ["hold error", "overshoot", "settling time", "chatter, below 0.05 N"]
    # with the digits of the verdict above them
    assert [value for value, _ in boxes] == ["0.094 N", "0.0 %", "0.85 s", "none"]


def test_a_run_with_tasks_has_no_box_for_the_settling_time_that_it_cannot_have(root: Path, tmp_path: Path):
    run = ReportRun("", read(execute(load_experiment(root / "experiments/pressing.toml"), tmp_path).recording))
    found = verdict_section([run], verdict([run]))
    names = re.findall(r"</strong><span>([^<]*)</span>", found)
    assert names == ["hold error", "overshoot", "chatter, below 0.05 N", "error since the first touch"]


def test_of_several_runs_the_same_three_numbers_stand_side_by_side(force_position: Recording, position: Recording):
    runs = [ReportRun("fp", force_position), ReportRun("p", position)]
    names = re.findall(r"</strong><span>([^<]*)</span>", verdict_section(runs, verdict(runs)))
    # without a force loop no force is held
    assert names == 2 * ["largest force", "lateral error", "the estimated position"]


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
    assert "23 of 29 claims of the paper&#x27;s text hold, 6 not reproduced" in page
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
