"""The accuracy budget on the page."""

import re
from html import unescape
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.kernel.recording.recording import Recording
from twin.report.page.page import report_page, write_report
from twin.report.page.run import ReportRun
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
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


def test_a_budget_is_made_of_the_experiment_as_it_was_recorded(root: Path, tmp_path: Path):
    settings = ["duration_s=8", "plant.backlash_deg=0.2"]
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", settings)
    execute(experiment, tmp_path)
    told: list[str] = []
    page = Path(
        write_report([tmp_path], None, True, lambda what, share=None: told.append(what)).facts["page"]
    ).read_text()
    budget = accuracy_budget(experiment)
    assert rows(page)["backlash"][2] == f"{budget.of('imperfection')[1].rms:.4f}"
    assert rows(page)["as it is"][2] == f"{budget.as_is.rms:.4f}"
    assert told[:2] == [f"fig4_force_position: {name}, {n} of 27" for n, name in ((1, "as it is"), (2, "ideal"))]


def test_a_run_without_force_has_no_budget(root: Path, tmp_path: Path):
    execute(load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.1"]), tmp_path)
    with pytest.raises(InputRefused, match=r"^fig4_force_position: does not press with more than 0\.5 N"):
        write_report([tmp_path], budget=True)
    assert not (tmp_path / "report.html").exists()
