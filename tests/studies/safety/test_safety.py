"""Lines of a hazard table by their runs, the page, and what got worse."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import beta

from tests.studies.safety.test_hazards import EVIDENCE, HEAD, LINE
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import InputRefused, SafetyTrip
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace
from twin.studies.command import ignore_progress
from twin.studies.faults.stage import Stage, load_stage
from twin.studies.faults.together import SECOND_DELAYS
from twin.studies.safety import argument
from twin.studies.safety.evidence import CONFIDENCE_LEVEL, EvidenceRun, HazardLine, interval
from twin.studies.safety.hazards import read_hazards
from twin.studies.safety.lines import draw_runs
from twin.studies.safety.page import hazard_page
from twin.studies.safety.study import safety, write_page
from twin.studies.safety.text import failures, lines_table, old_lines, regressions, verdict

EXPERIMENT = "experiments/pressing.toml"
MORE = """
[[threshold]]
name = "arm"
pressure_kPa = 130.0
source = "assumed: for this test"
[[threshold]]
name = "thigh"
force_N = 15.0
source = "assumed: for this test"
[[variant]]
name = "clutch"
set = ["drive.unpowered.holding_Nm=0"]
why = "shafts free without power"
[sensitivity]
keys = ["force_limit_N"]
factors = [0.6, 1.0]
bodies = ["scale"]
"""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("table") / "table.toml"
    small = EVIDENCE.replace("search = 0", "search = 4\nreach_mm = 5.0\ndraws = 6")
    file.write_text(HEAD + LINE + small + MORE)
    return file


@pytest.fixture(scope="module")
def lines(table: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[HazardLine], Path]:
    folder = tmp_path_factory.mktemp("page")
    return write_page(read_hazards(table), (), folder, False, ignore_progress)[0], folder


def test_a_line_is_kept_by_the_worst_of_its_runs_with_the_monitor(lines):
    (line,), _ = lines
    assert line.status == "kept" and line.worst is not None and line.worst.watched is not None
    assert line.value == max(run.watched.peak for run in line.runs if run.watched)
    assert line.worst.unwatched is not None and line.worst.unwatched.peak > line.worst.watched.peak
    ideal = line.worst.ideal
    assert ideal is not None and ideal.power_off == line.worst.watched.seen and ideal.peak <= line.value
    assert line.search_count == 4 and sum(run.found == "search" for run in line.runs) == 4
    assert line.variants["clutch"] is not None and line.variants["clutch"][1] < line.worst.watched.left


def test_the_terminal_prints_the_limit_and_where_the_monitor_detected_nothing(lines):
    (line,), _ = lines
    row: Any
    (row,) = lines_table([line]).rows
    assert row[2] == "22.5 N" and row[-1] == "kept"
    blind = [replace(run, watched=run.watched and replace(run.watched, reason="")) for run in line.runs]
    unseen = replace(line, runs=tuple(blind))
    (row,) = lines_table([unseen]).rows
    assert row[-2].startswith("0/") and row[-1] == unseen.status == unseen.to_dict()["status"] == "kept unseen"
    text = " ".join(verdict([unseen], {"worse": []}, [], {}).text.split())
    assert "as stated: 1 of 1 lines kept" in text and "Magnitudes: drive_runaway 0.5 to 8 rad/s." in text


def test_page_and_picture_print_a_line_that_is_kept_unseen(table: Path, lines, tmp_path: Path, monkeypatch):
    (line,), _ = lines
    blind = [replace(run, watched=run.watched and replace(run.watched, reason="")) for run in line.runs]
    unseen = [replace(line, runs=tuple(blind))]
    page = hazard_page(read_hazards(table), unseen, (), "twin safety")
    assert page.count('<span class="stated">kept unseen</span>') == 2
    assert "<td><b>magnitudes</b></td><td>drive_runaway 0.5 to 8 rad/s</td>" in page
    drawn: list[str] = []
    monkeypatch.setattr(argument, "_write_text", lambda axes, x, y, text, columns: drawn.append(text))
    argument.draw_argument(read_hazards(table), unseen, tmp_path / "argument.png")
    assert any(text.endswith("runs\nkept unseen") for text in drawn)


def again(run: EvidenceRun, *settings: str) -> tuple[bool, float]:
    """The run by its tables alone: whether its recording says that the monitor tripped, and the largest force."""
    tables = ", ".join(
        "{" + ", ".join(f"{key} = {json.dumps(value)}" for key, value in one.items()) + "}" for one in run.tables
    )
    experiment = load_experiment(Path(EXPERIMENT), (*run.settings, f"fault=[{tables}]", *settings), None, run.body)
    trace = Trace(only=["monitor.tripped", "plant.F_ee_B"])
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [trace])
    onset = round(run.tables[0]["onset_s"] / experiment.cosim.tick)
    force = max(math.dist((0.0, 0.0, 0.0), F) for F in trace["plant.F_ee_B"][onset:])
    watched = "monitor.enabled=false" not in settings
    return watched and bool(trace["monitor.tripped"].any()), math.inf if done.failure else force


def test_coverage_is_that_of_an_independent_count(lines):
    """Of the grid, of the drawn runs, and of the dangerous ones among these."""
    (line,), _ = lines
    grid, drawn = ([run for run in line.runs if run.found == found] for found in ("grid", "draw"))
    assert line.grid_detection == (sum(again(run)[0] for run in grid), len(grid))
    assert line.draw_detection == (sum(again(run)[0] for run in drawn), 6) and len(drawn) == 6
    dangerous = [run for run in drawn if again(run, "monitor.enabled=false")[1] > line.hazard.limit]
    assert line.dangerous_count == (sum(again(run)[1] <= line.hazard.limit for run in dangerous), len(dangerous))
    assert 0 < len(dangerous) < 6


@pytest.mark.parametrize("share", [(0, 7), (3, 9), (40, 40)])
def test_intervals_are_those_of_clopper_and_pearson(share: tuple[int, int]):
    """By the quantiles of the beta distribution."""
    seen, made = share
    less = 0.5 * (1.0 - CONFIDENCE_LEVEL)
    low = 0.0 if seen == 0 else beta.ppf(less, seen, made - seen + 1)
    high = 1.0 if seen == made else beta.ppf(1.0 - less, seen + 1, made - seen)
    assert interval(share) == pytest.approx((low, high))


def test_draws_are_of_the_seed_and_within_what_the_table_says(table: Path, lines):
    (line,), _ = lines
    (hazard,) = read_hazards(table).hazards

    @cache
    def robots(body: str, point: tuple[float, float]) -> Stage:
        return load_stage(Path(EXPERIMENT), (), body, point, share=False)

    def made(seed: int) -> list[tuple]:
        evidence = hazard.evidence.model_copy(update={"seed": seed, "draws": 3})
        return [(run.settings, run.tables) for run, _ in draw_runs(replace(hazard, evidence=evidence), robots)]

    assert made(0) == [(run.settings, run.tables) for run in line.runs if run.found == "draw"][:3]
    assert made(1) != made(0)
    for run in line.runs:
        if run.found == "draw":
            (one,) = run.tables
            assert 0.5 <= abs(one["magnitude_rad_per_s"]) <= 8.0 and 0.0 <= one["onset_s"] < 13.0
            (where,) = run.settings
            assert math.hypot(*json.loads(where.partition("=")[2])) <= 5.0 + 0.15


def test_a_second_fault_is_tried_at_every_delay_and_speed_after_the_trip_of_the_first(tmp_path: Path):
    """In the grid at the delays of ordered pairs; in search and draws at any, with drives that creep, too."""
    file = tmp_path / "table.toml"
    then = LINE.replace('"drive_runaway", ', '"sample_loss", then = { fault = "drive_runaway", ').replace(
        " }]", " } }]"
    )
    file.write_text(HEAD + then + EVIDENCE.replace("search = 0", "search = 12\ndraws = 12"))
    (line,), _ = write_page(read_hazards(file), (), tmp_path, True, ignore_progress)
    assert not line.failed_runs
    delays = []
    for run in line.runs:
        if run.found == "grid":
            assert run.watched is not None and run.watched.seen is not None
            delays.append(round(run.tables[1]["onset_s"] - run.tables[0]["onset_s"] - run.watched.seen, 3))
    assert set(delays) == set(SECOND_DELAYS)
    for found in ("search", "draw"):
        tables = [run.tables for run in line.runs if run.found == found]
        speeds = [abs(second["magnitude_rad_per_s"]) for _, second in tables]
        assert 0.05 <= min(speeds) < 0.4 < 1.0 < max(speeds) <= 8.0
        assert max(second["onset_s"] - first["onset_s"] for first, second in tables) > 1.5
    # a second failure in a retraction that no message shows
    assert line.worst is not None and line.value > 22.5 and line.status == "exceeded"


def test_a_place_where_the_robot_cannot_be_is_drawn_again_and_one_where_it_trips_fails(table: Path):
    (hazard,) = read_hazards(table).hazards
    evidence = hazard.evidence.model_copy(update={"draws": 2, "reach": 0.03})
    hazard = replace(hazard, evidence=evidence)
    asked_for: list[tuple[float, float]] = []

    def robots(body: str, point: tuple[float, float], trips: bool = False) -> Stage:
        asked_for.append(point)
        if trips and point != (0.0, 0.0):
            raise SafetyTrip("without any fault: FORCE")
        # beyond 10 mm from the axis it is refused
        return load_stage(Path(EXPERIMENT), ("monitor.workspace_radius_mm=10",), body, point, share=False)

    found = [run for run, _ in draw_runs(hazard, robots)]
    assert len(found) == 2 and all(run.watched for run in found)
    assert any(math.hypot(*point) > 0.01 for point in asked_for)
    failed = [run for run, _ in draw_runs(hazard, partial(robots, trips=True))]
    assert [run.failure for run in failed] == ["without any fault: FORCE"] * 2


def test_a_run_that_failed_makes_its_line_fail(lines):
    (line,), _ = lines
    broken = replace(line.runs[0], watched=None, failure="the drive crashed")
    assert replace(line, runs=(broken, *line.runs[1:])).status == "failed"
    said = " ".join(str(block) for block in failures([replace(line, runs=(broken, *line.runs[1:]))]))
    assert "H1: 1 run failed; drive_runaway of all drives on scale: the drive crashed" in said
    # also one that is known to go beyond its limit
    stated = replace(line.hazard, table=line.hazard.table.model_copy(update={"beyond": "no sensor"}))
    assert replace(line, hazard=stated, runs=(broken,)).status == "failed"
    assert replace(line, runs=()).status == "failed"


def test_a_limit_that_is_exceeded_is_said_unless_the_table_states_it(lines):
    (line,), _ = lines
    low = replace(line.hazard, limit=1.0)
    assert replace(line, hazard=low).status == "exceeded"
    stated = replace(low, table=low.table.model_copy(update={"beyond": "no sensor"}))
    assert replace(line, hazard=stated).status == "exceeded as stated"


def test_the_page_is_one_file_that_says_first_what_it_is_not(lines):
    (line,), folder = lines
    page = (folder / "safety.html").read_text()
    assert """Content-Security-Policy" content="default-src 'none';""" in page and "<script" not in page
    assert page.index("complies with no standard by itself") < page.index("H1")
    assert "What a reviewer still has to do" in page
    assert "<script" not in page and "http" not in page.replace("http-equiv", "")
    for run in line.runs:
        assert run.id in page and run.watched is not None and run.watched.digest in page
    assert page.count("data:image/png;base64,") == 2
    assert f"Drawn at random (seed 0): {line.draw_detection[0]} of 6 (95 % interval" in page
    assert "0 published thresholds, fewer than 2: taken as assumed" in page and "<td>15 N</td>" in page


def test_the_command_of_the_worst_run_makes_it_again(lines):
    (line,), _ = lines
    worst = line.worst
    assert worst is not None and "twin run pressing --body scale" in worst.command("pressing")
    assert worst.id == replace(worst, watched=None).id != replace(worst, seed=1).id


def test_a_point_moves_the_first_task_in_millimetres():
    robot = load_stage(Path(EXPERIMENT), (), "scale", (0.0, 0.02))
    assert robot.experiment.tasks[0].point == pytest.approx((0.0, 0.02))


def facts(lines: Sequence[HazardLine]) -> dict:
    return {line.hazard.table.id: line.to_dict() for line in lines}


def test_only_what_got_worse_is_named(lines):
    (line,), _ = lines
    old = facts([line])
    assert list(regressions(old, [line.to_dict()])) == []
    better = {**line.to_dict(), "peak_N": 0.5 * line.to_dict()["peak_N"]}
    assert list(regressions(old, [better])) == []
    changes = {
        "status": ("exceeded", "H1: exceeded, was kept"),
        "detected": (line.to_dict()["detected"] - 1, "seen, were"),
        "drawn": ({"count": 0, "of": 6}, "0 of 6 drawn runs seen, were"),
        "peak_N": (1.06 * line.to_dict()["peak_N"], "peak .* N, was"),
    }
    for key, (value, sentence) in changes.items():
        (found,) = regressions(old, [{**line.to_dict(), key: value}])
        assert re.search(sentence, found)
    assert list(regressions(old, [{**line.to_dict(), "status": "kept unseen"}])) == []
    unseen = {"H1": {**old["H1"], "status": "kept unseen"}}
    assert list(regressions(unseen, [{**line.to_dict(), "status": "exceeded"}])) == ["H1: exceeded, was kept"]
    assert list(regressions(old, [])) == ["H1: the line is gone"]
    assert list(regressions(old, [{**line.to_dict(), "peak_N": 1.04 * line.to_dict()["peak_N"]}])) == []


@cache
def answer(file: Path, out: Path, *settings: str, against: Path | None = None):
    return safety([file], ignore_progress, against, True, None, settings, out)


def test_worse_settings_of_the_monitor_fail_against_the_old_page_and_by_the_limit(table: Path, tmp_path: Path):
    first = answer(table, tmp_path / "first")
    shown = [line for line in first.text.splitlines() if str(tmp_path) not in line]
    assert first.exit_code == 0 and max(map(len, shown)) <= 80
    old = tmp_path / "first" / "safety.json"
    assert answer(table, tmp_path / "same", against=old).exit_code == 0
    changed = answer(table, tmp_path / "changed", "monitor.disobeyed=wait", against=old)
    assert changed.exit_code == 1 and any("was kept" in text for text in changed.facts["worse"])


@pytest.mark.parametrize(
    ("was", "now", "sentence"),
    [
        ('bodies = ["scale"]', 'bodies = ["scle"]', "table.toml: bodies: scle: .*no such body"),
        ("holding_Nm", "holdng_Nm", r"table.toml: \[\[variant\]\] clutch: [\s\S]*unknown key"),
        ("force_limit_N", "force_limt_N", "not a number of .monitor.; did you mean 'force_limit_N'"),
        (
            'factors = [0.6, 1.0]\nbodies = ["scale"]',
            'factors = [0.6, 1.0]\nbodies = ["x"]',
            "sensitivity. x: .*no such",
        ),
        ("pressing", "fig4_force_position", "no safety monitor watches"),
    ],
)
def test_what_no_run_can_be_made_of_is_refused_before_the_first(
    table: Path, tmp_path: Path, was: str, now: str, sentence: str
):
    file = tmp_path / "table.toml"
    file.write_text(table.read_text().replace(was, now, 1))
    with pytest.raises(InputRefused, match=sentence):
        safety([file], ignore_progress, None, False, None, (), tmp_path / "page")
    assert not (tmp_path / "page").exists()


def test_what_is_no_data_of_a_page_is_refused(tmp_path: Path):
    for text in ("", "{}", "[1]"):
        file = tmp_path / "old.json"
        file.write_text(text)
        with pytest.raises(InputRefused, match="not the data of twin safety"):
            old_lines(file)
    with pytest.raises(InputRefused, match="No such file"):
        old_lines(tmp_path / "none.json")
