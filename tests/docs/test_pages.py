"""What pages say of the repository is so."""

import json
import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest


@pytest.fixture(scope="module")
def drives(root: Path) -> dict[str, zipfile.ZipFile]:
    return {path.stem: zipfile.ZipFile(path) for path in sorted((root / "fmus").glob("*/*.fmu"))}


def described(drive: zipfile.ZipFile) -> ElementTree.Element:
    return ElementTree.fromstring(drive.read("modelDescription.xml"))


def types(drive: zipfile.ZipFile) -> set[str]:
    variables = described(drive).find("ModelVariables")
    assert variables is not None
    # in FMI 2.0 the type is an element within the variable, in FMI 3.0 the variable itself
    return {v[0].tag if v.tag == "ScalarVariable" else v.tag for v in variables}


def test_fmi_versions_and_types_of_the_drives_are_as_their_page_says(root: Path, drives: dict[str, zipfile.ZipFile]):
    page = " ".join((root / "fmus" / "README.md").read_text().split())
    versions = {name: described(drive).get("fmiVersion") for name, drive in drives.items()}
    assert {name for name, version in versions.items() if version != "2.0"} == {"torque_motor_fmi3"}
    assert versions["torque_motor_fmi3"] == "3.0"
    assert "eight of them are FMI 2.0, `torque_motor_fmi3` is FMI 3.0." in page
    assert {kind for name in drives if versions[name] == "2.0" for kind in types(drives[name])} == {"Real"}
    assert types(drives["torque_motor_fmi3"]) == {"Float64", "Float32", "Int32", "Boolean"}
    assert "All variables of the FMI 2.0 drives are Real" in page


def test_the_drives_without_macos_are_those_that_the_readme_names(root: Path, drives: dict[str, zipfile.ZipFile]):
    lacking = {n for n, drive in drives.items() if not any("darwin" in name for name in drive.namelist())}
    assert lacking == {"python_servo"}
    assert "macOS (not `python_servo`)" in (root / "README.md").read_text()


def test_pages_state_one_time_for_make_test(root: Path):
    row = re.compile(r"make test`?[^-\w].*?(\d+) minutes")
    pages = ("README.md", "CONTRIBUTING.md", "docs/building.md")
    times = {name: row.findall((root / name).read_text()) for name in pages}
    assert all(len(found) == 1 for found in times.values()), times
    assert len({found[0] for found in times.values()}) == 1, times


def test_pages_state_one_time_for_fig_4(root: Path):
    growth = {one["name"]: one for one in json.loads((root / "docs/performance.json").read_text())}
    stepping = f"{growth['stepping Fig. 4, slow drives']['seconds'][0]:.3f} s"
    for name in ("how_it_works.md", "building.md"):
        page = " ".join((root / "docs" / name).read_text().split())
        assert f"stepped in {stepping} and, with recording, in 0.05 s" in page, name
    assert "take about 0.05 s" in (root / "README.md").read_text()
