import json
import shutil
from pathlib import Path

import pytest

from tests.cli.test_run import FIG4
from tests.command_line import twin
from tests.kernel.recording import samples
from twin.kernel.recording.reader import Recording
from twin.report.page.page import report_page
from twin.report.page.run import report_runs


def test_the_verdict_is_printed_first_then_where_the_page_is(force_position: Recording, tmp_path: Path):
    done = twin("report", force_position.path.parent, "--out", "page.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Hold error 0.094 N; ")
    assert done.stdout.endswith("; 5 of 5 of this run's own checks hold\n  page  page.html\n")
    assert (tmp_path / "page.html").stat().st_size < 8e6


@pytest.mark.slow
def test_a_page_is_the_same_whichever_process_drew_its_picture(
    force_position: Recording, position: Recording, tmp_path: Path
):
    runs = [recording.path.parent for recording in (force_position, position)]
    # on a machine with one core both are drawn here
    for shown in (runs[:1], runs):
        assert twin("report", *shown, "--out", "page.html", cwd=tmp_path, isolated=True).returncode == 0
        html, _ = report_page(report_runs(shown))
        assert (tmp_path / "page.html").read_text(encoding="utf-8") == html


def test_several_runs_share_a_page(force_position: Recording, position: Recording, tmp_path: Path):
    done = twin("report", force_position.path, position.path, "--json", cwd=tmp_path)
    facts = json.loads(done.stdout)
    begin = "fig4_position beside fig4_force_position: no verdict, another reference; "
    assert facts["headline"].startswith(begin)
    assert (
        facts["headline"].endswith(
            "; 23 of 29 claims of the paper's text hold, 6 not reproduced; 5 of 5 of this run's own checks hold"
        )
        and facts["page"] == "results/report/report.html"
    )
    assert (tmp_path / "results/report/report.html").exists()


def test_a_run_can_report_on_itself_with_time_by_component(root: Path, tmp_path: Path):
    done = twin("run", root / FIG4, "--set", "duration_s=1", "--report", "--out", "mine", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "  page  mine/report.html"
    assert "plant, per tick" in (tmp_path / "mine/report.html").read_text()


def test_a_run_that_trips_is_reported_and_still_ends_with_4(root: Path, tmp_path: Path):
    jump = ["contact.shift.by_mm=[0, 0, 8]", "contact.shift.start_s=3", "contact.shift.rise_s=0.05"]
    settings = [word for text in jump for word in ("--set", text)]
    done = twin("run", root / "experiments/pressing.toml", *settings, "--report", "--out", "mine", cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    assert "safety monitor" in (tmp_path / "mine/report.html").read_text().partition("Replay</h2>")[0]


def test_a_truncated_recording_is_reported_as_far_as_it_goes(force_position: Recording, tmp_path: Path):
    whole = force_position.path.read_bytes()
    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) // 2])
    done = twin("report", "run.mcap", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Unfinished recording: read up to ")


def broken(kind: str, whole: Path, path: Path) -> None:
    """A recording at `path` that cannot be reported on."""
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 0xFF
    texts = {
        "damaged": bytes(content),
        "foreign": b"\x89PNG\r\n\x1a\n" + bytes(100),
        "empty": b"",
        "without samples": bytes(content[:60]),
    }
    path.write_bytes(texts[kind])


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("damaged", "damaged at byte"),
        ("foreign", "not an MCAP file, expected a recording of twin"),
        ("empty", "an empty file, expected a recording of twin"),
        ("without samples", "holds no samples"),
    ],
)
def test_what_cannot_be_reported_is_one_message(kind: str, said: str, tmp_path: Path):
    broken(kind, samples.finished(tmp_path / "whole.mcap"), tmp_path / "run.mcap")
    done = twin("report", "run.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and done.stderr.startswith("run.mcap: ") and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "report.html").exists()


def test_a_run_given_twice_is_refused(force_position: Recording, tmp_path: Path):
    done = twin("report", force_position.path, force_position.path.parent, cwd=tmp_path)
    assert done.returncode == 2 and "given twice" in done.stderr


def test_runs_of_one_experiment_are_told_apart_by_their_folders(force_position: Recording, tmp_path: Path):
    for name in ("soft", "stiff"):
        (tmp_path / name).mkdir()
        shutil.copy(force_position.path, tmp_path / name)
    done = twin("report", "soft", "stiff", "--out", "page.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fig4_force_position soft | fig4_force_position stiff" in (tmp_path / "page.html").read_text()


def test_a_page_that_cannot_be_written_is_refused(force_position: Recording, tmp_path: Path):
    (tmp_path / "file").touch()
    done = twin("report", force_position.path, "--out", "file/page.html", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "file: cannot be created: File exists\n"
    full = twin("report", force_position.path, "--out", "/sys/page.html", cwd=tmp_path)
    assert full.returncode == 3
    assert full.stderr.startswith("/sys/page.html: cannot be written: ")
