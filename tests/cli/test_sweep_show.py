"""`twin sweep show`: text, pictures, page and JSON of a folder."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.studies.sweep.statistics.rows import row
from twin.cli.app import twin_command
from twin.kernel.errors import InputRefused, NotWritten
from twin.studies.sweep.rows import ROWS_FILE
from twin.studies.sweep.stored import MARGINS_FILE, SWEEP_FILE


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sweep's folder as `twin sweep` leaves it: eleven runs done, one failed."""
    rows = [
        row(n, {"a.k": float(n % 4), "b.c": float(n // 4)}, hold_error_N=1.0 + n % 4, end_N=5.0, lateral_error_mm=2.0)
        for n in range(1, 12)
    ]
    rows.append(row(12, {"a.k": 0.0, "b.c": 3.0}))
    facts = {
        "sweep": "made_up", "runs": 12, "design": "grid", "drives": [], "labels": ["a.k", "b.c"],
        "metrics": ["hold_error_N", "end_N", "lateral_error_mm"], "limits": {}, "configuration": {},
    }  # fmt: skip
    (tmp_path / SWEEP_FILE).write_text(json.dumps(facts))
    (tmp_path / ROWS_FILE).write_text("".join(json.dumps(one) + "\n" for one in rows))
    return tmp_path


def shown(*arguments: str) -> str:
    done = CliRunner().invoke(twin_command(), ["sweep", "show", *arguments], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def test_the_answer_comes_first_and_the_files_last(folder: Path):
    lines = shown(str(folder), "--html").splitlines()
    assert lines[0] == "made_up  12 runs: smallest hold_error_N 1 (run 4: k = 0, c = 1), equal to 1"
    assert lines[1] == "  other within 0.05 N; k at the edge of the range tried; 1 failed"
    assert lines[-1].split() == ["page", str(folder / "sweep.html")]
    assert {path.name for path in folder.iterdir()} >= {"map.png", "metrics.png", "sweep.html"}


def test_nothing_runs_by_being_looked_at(folder: Path):
    margins = {"4": {"run": 4, "gain": 129.0, "phase_rad": 1.9, "reason": ""}}
    (folder / MARGINS_FILE).write_text(json.dumps(margins))
    # a sweep of somebody else may name an experiment whose drives are native code
    facts = json.loads((folder / SWEEP_FILE).read_text())
    (folder / SWEEP_FILE).write_text(json.dumps({**facts, "origin": {"file": str(folder / "theirs.toml")}}))
    script = (
        "import sys\n"
        "from click.testing import CliRunner\n"
        "from twin.cli.app import twin_command\n"
        "started = []\n"
        "sys.addaudithook(lambda event, _: started.append(event) if event in ('os.fork', 'os.posix_spawn', 'os.exec', "
        "'subprocess.Popen') else None)\n"
        "done = CliRunner().invoke(twin_command(), ['sweep', 'show', sys.argv[1]], catch_exceptions=False)\n"
        "print(done.stdout)\n"
        "print('ran', started, 'twin.robot.assembly.load' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True, check=True)
    assert "margins of the force loop" in done.stdout and "129" in done.stdout
    assert done.stdout.splitlines()[-1] == "ran [] False"


@pytest.mark.parametrize("content", ['{"4": {"gain": 1.0}}', "[]", '{"4": ', '{"4": {"run": 4, "gain": 1e999}}'])
def test_margins_that_twin_did_not_write_are_refused(folder: Path, content: str):
    (folder / MARGINS_FILE).write_text(content)
    done = CliRunner().invoke(twin_command(), ["sweep", "show", str(folder)])
    assert isinstance(done.exception, InputRefused) and f"{folder / MARGINS_FILE}: not what" in str(done.exception)


def test_the_worst_over_a_parameter_is_asked_for_by_its_short_name(folder: Path):
    lines = shown(str(folder), "--worst-over", "c").splitlines()
    assert lines[3] == "worst hold_error_N over c, least worst first"
    # a.k = 0 has the run that failed
    assert lines[5].split() == ["1", "2", "0", "3", "-"] and lines[8].split() == ["0", "failed", "3", "3", "1"]


def test_it_is_told_before_anything_is_drawn(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise NotWritten("no room")

    monkeypatch.setattr("twin.studies.sweep.show.pictures.write_pictures", refuse)
    done = CliRunner().invoke(twin_command(), ["sweep", "show", str(folder)])
    assert isinstance(done.exception, NotWritten)
    assert done.stdout.startswith("made_up  12 runs: ")


def test_json_has_rows_tables_and_files_but_no_curves(folder: Path):
    with (folder / ROWS_FILE).open("a") as file:
        judged = {**row(13, {"a.k": 0.5, "b.c": 0.5}, hold_error_N=0.1), "curves": {"period_s": 0.04, "of": {}}}
        file.write(json.dumps({**judged, "curves": {}}) + "\n")
    facts = json.loads(shown(str(folder), "--json"))
    assert len(facts["rows"]) == 13 and not any("curves" in one for one in facts["rows"])
    assert {table["key"] for table in facts["tables"]} >= {"best", "correlation", "metrics", "reasons"}
    assert Path(facts["files"]["map"]).is_file()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--by", "end_N"], "is not better; rank by hold_error_N, lateral_error_mm"),
        (["--by", "hold_error"], "did you mean 'hold_error_N"),
        (["--against", "peek"], "--against peek: no such metric"),
        (["--x", "b.d"], "--x b.d: no number that varies here"),
        (["--worst-over", "b.d"], "--worst-over b.d: does not vary here; did you mean 'b.c'"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_what_can(folder: Path, options: list[str], sentence: str):
    with pytest.raises(InputRefused, match=sentence):
        shown(str(folder), *options)


def test_a_folder_that_is_no_sweeps_is_refused(tmp_path: Path):
    with pytest.raises(InputRefused, match="not the folder of a sweep"):
        shown(str(tmp_path))


def test_a_folder_without_a_finished_run_is_shown_as_one(folder: Path):
    (folder / ROWS_FILE).write_text("")
    assert shown(str(folder), "--html").startswith("made_up  0 of 12 runs")
