"""A drive or controller refuses a state with a value that it cannot have, and none of them makes it crash."""

import math
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest
from builder.drive import FMUS, drive_names, load_drive, part_names

from tests.fmu.forged import MODES, NUMBERS

COMPILED = [*drive_names("2.0"), *drive_names("3.0"), *part_names()]


@pytest.mark.parametrize("drive", COMPILED)
def test_every_odd_value_in_every_place_of_a_state_is_refused_or_stepped_without_a_crash(drive: str, tmp_path: Path):
    paths = os.pathsep.join(map(str, (FMUS, FMUS.parent)))
    done = subprocess.run(
        [sys.executable, "-m", "tests.fmu.forged", drive, str(tmp_path)],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    *lines, last = [line[2:] for line in done.stdout.splitlines() if line.startswith("> ")] or [""]
    assert (done.returncode, last) == (0, "end"), f"{done.returncode} after {lines[-1:]}: {done.stderr}"
    outcomes: dict[str, dict[float, str]] = defaultdict(dict)
    for line in lines:
        name, number, outcome = line.split()
        outcomes[name][float(number)] = outcome
    assert {mode: outcomes["mode"][mode] for mode in MODES} == {
        mode: "restored" if 0 <= mode < 4 else "refused" for mode in MODES
    }
    assert [value for value, outcome in outcomes["time"].items() if outcome == "refused"] == pytest.approx(
        [math.nan, math.inf, -math.inf], nan_ok=True
    )
    for variable in load_drive(drive).variables:
        low, high = variable.bounds
        for value in NUMBERS:
            possible = low <= value <= high and not (variable.is_whole and value % 1)
            found = next(v for k, v in outcomes[variable.name].items() if k == value or (k != k and value != value))
            assert found == ("restored" if possible else "refused"), (variable.name, value)


def test_the_places_of_a_state_that_may_be_infinite_are_those_of_a_phase_without_an_end():
    infinite = [
        (name, variable.name)
        for name in COMPILED
        for variable in load_drive(name).variables
        if any(map(math.isinf, variable.bounds))
    ]
    assert infinite == [("paper_law", "m_total"), ("paper_law", "m_z_turn"), ("paper_law", "m_z_lowest")]
