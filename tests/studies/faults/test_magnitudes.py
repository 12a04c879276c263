"""How large a fault may be, and what the pages say of the worst."""

import random
import re
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from tests.studies.faults.beyond import BODIES, Tried, ideal, ladder, run
from twin.robot.experiment.fault import FAULT_KINDS, Fault
from twin.robot.experiment.together import fault_values
from twin.studies.faults.cases import faults_of
from twin.studies.faults.magnitudes import UPPER_ENDS, directions
from twin.studies.faults.onsets import true_force
from twin.studies.faults.stage import load_stage

DOCS = EXPERIMENTS.parent / "docs"
PAGE = DOCS / "safety.md"
SEED, DRAWN = 50, 6


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def section(title: str, page: Path) -> list[list[str]]:
    """Rows of the table below a heading of a page."""
    text = page.read_text().split(f"\n{title}\n")[1].split("\n## ")[0]
    return [cells(line) for line in text.splitlines() if line.startswith("| `")]


WORST = "## Larger than the catalogue"


def test_every_kind_with_a_magnitude_has_an_upper_end_no_smaller_than_the_catalogue():
    assert UPPER_ENDS.keys() == {kind for kind, known in FAULT_KINDS.items() if known.magnitudes}
    for kind, end in UPPER_ENDS.items():
        magnitudes = FAULT_KINDS[kind].magnitudes
        assert magnitudes is not None
        smallest, largest = magnitudes[0], magnitudes[-1]
        assert end.why and end.magnitude * largest > 0.0
        assert abs(end.magnitude) <= abs(largest) if abs(largest) < abs(smallest) else end.magnitude / largest >= 1.0


def test_the_page_has_a_row_for_every_kind_with_its_upper_end():
    rows = section(WORST, DOCS / "faults_reference.md")
    assert [row[0].strip("`") for row in rows] == list(UPPER_ENDS)
    for row in rows:
        end = UPPER_ENDS[row[0].strip("`")]
        assert (float(row[1].split()[0].replace(",", "")), row[2]) == (end.magnitude, end.why)


def test_page_readme_and_hazard_table_state_the_force_of_a_fast_drift():
    """The claim's own range ends at 2 deg/s; the largest force is that of 20 deg/s."""
    pages = [PAGE, DOCS.parent / "README.md", EXPERIMENTS / "safety" / "massage.toml"]
    for page in pages:
        assert re.search(r"47 N (at|if all joint encoders drift\s+by) 20 deg/s", page.read_text()), page
    (header,) = (
        cells(line) for line in PAGE.read_text().splitlines() if line.startswith("| all joint encoders, deg/s")
    )
    (row,) = (cells(line) for line in PAGE.read_text().splitlines() if line.startswith("| shoulder | 20.3"))
    assert max(map(float, row[1:])) == float(row[header.index("20")]) == 46.6


@pytest.mark.slow
def test_the_worst_runs_that_the_page_states_give_its_numbers():
    """Of a draw of rows, on both bodies; the drifts always."""
    rows = {row[0].strip("`"): row for row in section(WORST, DOCS / "faults_reference.md")}
    drawn = {"encoder_drift", *random.Random(SEED).sample(sorted(rows), DRAWN)}
    for kind in sorted(drawn):
        for body, text in zip(BODIES, rows[kind][3:5], strict=True):
            stated = re.fullmatch(r"([\d.]+)(?: \(([\d.]+)\))?: (-?[\d.]+) ?[^,]*, ([a-z_0-9 ]+), ([\d.]+) s", text)
            assert stated is not None, text
            size, target, onset = float(stated[3]), stated[4], float(stated[5])
            felt = run(body, kind, target, size, onset)
            # another processor may round
            assert felt.peak == pytest.approx(float(stated[1]), rel=0.02, abs=0.06), (kind, body)
            best = ideal(body, kind, Tried(target, size, onset, felt))
            assert (best is None) == (stated[2] is None)
            assert best is None or best == pytest.approx(float(stated[2]), rel=0.02, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.endurance] if number else [])
        for number, kind in enumerate(random.Random(SEED + 1).sample(sorted({*UPPER_ENDS} - {"encoder_drift"}), 3))
    ],
)
def test_no_run_of_a_drawn_kind_presses_harder_than_the_page_states(kind: str):
    (row,) = (row for row in section(WORST, DOCS / "faults_reference.md") if row[0] == f"`{kind}`")
    for body, text in zip(BODIES, row[3:5], strict=True):
        assert max(one.felt.peak for one in ladder(body, kind)) < 1.02 * float(text.split(" ")[0].rstrip(":")) + 0.06


STATED = [
    # body, kind, target, magnitude, onset (s), force (N)
    ("back", "encoder_drift", "all joint encoders", 0.1, 0.5, 10.6),
    ("back", "encoder_drift", "joint_encoder_1", 12.0, 5.5, 22.1),
    ("shoulder", "belt_slip", "all joints", -30.0, 0.499, 76.3),
    ("shoulder", "breathing", "contact", 12.0, 0.499, 17.1),
    ("back", "controller_overrun", "controller", 50.0, 5.449, 17.0),
    ("shoulder", "controller_overrun", "controller", 50.0, 5.511, 18.3),
    ("back", "surface_jump", "contact", 5.0, 5.449, 20.2),
    ("shoulder", "drive_runaway", "all drives", 60.0, 9.408, 30.5),
    ("shoulder", "drive_runaway", "all drives", 60.0, 5.511, 24.3),
]
"""Single runs that docs/safety.md, docs/faults.md and docs/faults_reference.md state."""


@pytest.mark.parametrize(("body", "kind", "target", "magnitude", "onset", "force"), STATED)
def test_single_runs_that_the_pages_state_give_their_force(
    body: str, kind: str, target: str, magnitude: float, onset: float, force: float
):
    # another processor may round
    assert run(body, kind, target, magnitude, onset).peak == pytest.approx(force, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "onset", "force", "with_sensor"), [("shoulder", 2.5, 44.1, 15.0), ("back", 2.5, 36.2, 17.0)]
)
def test_a_drive_without_droop_presses_as_the_page_states(body: str, onset: float, force: float, with_sensor: float):
    there = load_stage(EXPERIMENTS / "pressing.toml", body=body, drive="pmsm_foc")
    faults = faults_of(there.experiment, [fault_values("encoder_drift", "all joint encoders", 2.0, onset)])
    pressed = true_force(there.run(faults))
    assert pressed.max() == pytest.approx(force, rel=0.02)
    # a sensor of the true force cuts the power at 15 N
    at = int(np.argmax(pressed >= 15.0))
    cut = there.reaction((*faults, Fault("power_off", "power", at)))
    assert cut.peak == pytest.approx(with_sensor, rel=0.02)


@pytest.mark.slow
def test_faster_drifts_of_all_joint_encoders_press_as_the_page_states():
    """A draw of cells: worst of three onsets and both signs."""
    lines = [cells(line) for line in PAGE.read_text().splitlines() if line.startswith("| all joint encoders, deg/s")]
    header = lines[0][1:]
    table = [
        cells(line) for line in PAGE.read_text().splitlines() if re.match(r"\| (back|shoulder) \| [\d.]+ \|", line)
    ]
    chosen = random.Random(SEED).sample([(row[0], n) for row in table for n in range(len(header) - 1)], 3)
    for body, n in chosen:
        (row,) = (row for row in table if row[0] == body)
        peaks = [
            run(body, "encoder_drift", "all joint encoders", sign * float(header[n]), onset).peak
            for onset in (0.5, 2.5, 5.5)
            for sign in directions("encoder_drift")
        ]
        assert max(peaks) == pytest.approx(float(row[n + 1]), rel=0.02), (body, header[n])
