"""The reference files that the FMUs carry: results of FMPy, which this project's own machinery gets, too."""

import shutil
from pathlib import Path

import pytest
from builder.references import FILES, carry_references

from tests.kernel.fmi.archives import altered
from twin.studies.reference.outcome import MANIFEST_FOLDER, References, reference_files, references

DRIVES = sorted(path.stem for path in (Path(__file__).resolve().parents[2] / "fmus").glob("*/*.fmu"))
ROUNDING = 1e-4
"""Of the tolerance, which is 1 % of a signal's range: results are written with nine digits."""
STEPLESS, COARSER = ("modelica_dc", "python_servo"), 0.2
"""They state no step, so theirs is 2 ms here, and FMPy's was 1 ms: what an Euler step of the servo's 20 ms leaves."""


def tried(file: Path) -> References:
    found = references(file, apart=False)
    assert found is not None
    return found


@pytest.mark.parametrize("drive", DRIVES)
def test_the_twin_gets_from_every_drive_what_another_importer_got(root: Path, drive: str):
    found = tried(root / "fmus" / drive / f"{drive}.fmu")
    (ramps,) = found.outcomes
    assert ramps.word == "agrees" and dict(found.reference_files.unread).keys() == {"ramps.exp"}
    assert len(ramps.deviations) >= 2 and max(ramps.deviations.values()) < (COARSER if drive in STEPLESS else ROUNDING)


def test_results_depend_on_the_parameters_that_are_carried(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    at_start = altered(good, tmp_path / "a.fmu", lambda n, c: (n, c.replace(b'"1.2"', b'"0.6"')))
    (ramps,) = tried(at_start).outcomes
    assert ramps.word == "differs" and ramps.deviations["omega_m"] > 1.0


def test_writing_them_again_gives_the_same_bytes_and_changes_nothing_else(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    copy = Path(shutil.copy(good, tmp_path))
    carry_references("velocity_servo", copy)
    assert copy.read_bytes() == good.read_bytes()
    (ramps,) = reference_files(copy).trials
    told = [f"{MANIFEST_FOLDER}/{file}" for file, *_ in FILES]
    assert [ramps.parameters, ramps.stimuli, ramps.results] == [told[0], *told[2:]]
