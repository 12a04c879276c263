"""The page of a system of FMUs, and what it refuses."""

from pathlib import Path

import pytest

from tests.kernel.systems.archives import archive, component, connection, structure, system, values
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import Recording
from twin.kernel.systems.additions import Additions
from twin.report.page.page import write_report
from twin.studies.systems.recorded import record_system

SHAFTS = structure(
    system(
        [component("a", "a.fmu", bindings=values("omega_ref=1")), component("b", "a.fmu")],
        [connection("a.omega_m", "b.omega_ref")],
    ),
    0.01,
)


@pytest.fixture
def run(tmp_path: Path, root: Path) -> Path:
    """A run of two shafts and a signal."""
    fmu = root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu"
    file = archive(tmp_path / "shafts.ssp", SHAFTS, {"a.fmu": fmu})
    additions = Additions(inputs=["a.tau_load=sin(t)"], recorded=["*"])
    record_system(DirectReporter(lambda note: None), file, out=tmp_path / "run", additions=additions)
    return tmp_path / "run"


def test_the_page_shows_signals_by_unit_components_with_hashes_and_where_all_is_from(run: Path, root: Path):
    answer = write_report([run])
    html = (run / "report.html").read_text()
    assert answer.text.startswith("2 components, 0.01 s, no warnings.")
    assert html.count('class="picture"') == 3
    for unit, count in (("rad", "2 signals"), ("rad/s", "4 signals"), ("N.m", "3 signals")):
        assert f"{count} in {unit}" in html
    assert html.count("velocity.fmu") == 0 and html.count("a.fmu") >= 2
    for told in (
        "a.omega_m -&gt; b.omega_ref",
        "input a.tau_load",
        "sin(t)",
        "gauss_seidel, steps of 1 ms",
        "stepping",
    ):
        assert told in html, told
    assert "<title>shafts</title>" in html
    # the same recording gives the same page
    write_report([run])
    assert (run / "report.html").read_text() == html


def test_without_what_was_kept_beside_the_recording_the_page_says_so(run: Path):
    (run / "summary.json").unlink()
    write_report([run])
    assert "The duration was not saved" in (run / "report.html").read_text()


def test_a_system_and_the_robot_get_no_page_together(run: Path, force_position: Recording):
    with pytest.raises(InputRefused, match="records the robot, and another run a system of FMUs"):
        write_report([run, force_position.path])
    with pytest.raises(InputRefused, match="leave --budget out"):
        write_report([run], budget=True)
