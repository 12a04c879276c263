"""What an FMU carries: the files that its manifest lists, and values of parameters in its own units."""

from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.archives import carrying
from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_TEXT_BYTES
from twin.kernel.fmi.description import FmuDescription, described
from twin.studies.reference.outcome import (
    MANIFEST_FILE,
    MANIFEST_FOLDER,
    MAX_RELATED_FILES,
    parameters_of,
    reference_files,
    series_of,
)

NAMED = (
    'xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" '
    'fmi-ls:fmi-ls-version="1.0.0-alpha.1"'
)


@pytest.fixture
def file(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


@pytest.fixture
def servo(file: Path) -> FmuDescription:
    return described(file)


def manifest(*sources: str, role: str = "result", type_: str = "text/csv") -> str:
    listed = "".join(f'<Related source="{source}" role="{role}" type="{type_}"/>' for source in sources)
    return f"<fmiReferences {NAMED}>{listed}</fmiReferences>"


def ssv(*parameters: str) -> bytes:
    listed = "".join(f"<ssv:Parameter {one}</ssv:Parameter>" for one in parameters)
    return (
        '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" '
        f'name="p"><ssv:Parameters>{listed}</ssv:Parameters></ssv:ParameterSet>'
    ).encode()


def real(name: str, value: str, unit: str = "") -> str:
    return f'name="{name}"><ssv:Real value="{value}" unit="{unit}"/>'


def test_an_fmu_without_a_manifest_carries_nothing(file: Path, tmp_path: Path):
    found = reference_files(carrying(file, tmp_path / "a.fmu", {}))
    assert found.trials == () and found.unread == ()


def test_results_have_the_inputs_of_the_same_name(file: Path, tmp_path: Path):
    """Reference-FMUs call results NAME_out.csv."""
    entries: dict[str, str | bytes] = {
        f"{MANIFEST_FOLDER}/a b_in.csv": "",
        f"{MANIFEST_FOLDER}/a b_out.csv": "",
        f"{MANIFEST_FOLDER}/c_ref.csv": "",
    }
    first, second = reference_files(
        carrying(file, tmp_path / "a.fmu", {MANIFEST_FILE: manifest("a%20b_out.csv", "c_ref.csv"), **entries})
    ).trials
    assert (first.results, first.stimuli) == (f"{MANIFEST_FOLDER}/a b_out.csv", f"{MANIFEST_FOLDER}/a b_in.csv")
    assert (second.name, second.stimuli, second.parameters) == ("c_ref.csv", "", "")


def test_a_source_is_a_file_of_the_fmu_or_none(file: Path, tmp_path: Path):
    inside = ["../../modelDescription.xml", "./fmi-ls-manifest.xml", "../../sources/../modelDescription.xml#part"]
    outside = [
        "nothing.csv", "../../../etc/passwd", "../../../../modelDescription.xml", "/etc/passwd",
        "/modelDescription.xml", "file:///etc/passwd", "http://example.org/modelDescription.xml",
        "..%2F..%2F..%2Fetc%2Fpasswd", "C:/x", "..", "",
    ]  # fmt: skip
    found = reference_files(carrying(file, tmp_path / "a.fmu", {MANIFEST_FILE: manifest(*inside, *outside)}))
    assert len(found.trials) == len(inside)
    assert [name for name, why in found.unread if why.startswith("not in the FMU")] == outside


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<fmiReferences/>", "expected <fmiReferences> of 'org.fmi-standard.fmi-ls-ref'"),
        (manifest("x").replace("fmiReferences", "other"), "<other>"),
        (manifest(*["x"] * (MAX_RELATED_FILES + 1)), f"expected at most {MAX_RELATED_FILES}"),
        (f'<!DOCTYPE x [<!ENTITY y SYSTEM "/etc/passwd">]>{manifest("&y;")}', "DOCTYPE"),
        ("not XML", "not valid XML"),
        (" " * (MAX_TEXT_BYTES + 1), "expected at most 10 MB"),
    ],
)
def test_a_manifest_that_is_none_is_refused_in_a_sentence(file: Path, tmp_path: Path, text: str, told: str):
    bad = carrying(file, tmp_path / "a.fmu", {MANIFEST_FILE: text})
    with pytest.raises(InputRefused, match=MANIFEST_FILE) as refused:
        reference_files(bad)
    assert told in str(refused.value) and "\n" not in str(refused.value)


def test_values_are_in_the_units_of_the_fmu(servo: FmuDescription):
    given = ssv(real("J_m", "1e-4", "kg.m2"), real("omega_max", "60"))
    assert parameters_of(given, "x", servo) == {"J_m": 1e-4, "omega_max": 60.0}


def test_names_and_values_that_the_fmu_does_not_know_are_refused(servo: FmuDescription):
    for parameter, told in (
        (real("drop", "1"), "no parameter 'drop'; did you mean 'droop'?"),
        (real("omega_m", "1"), "no parameter 'omega_m'"),
        (real("J_m", "-1"), "J_m = -1: expected 1e-09"),
        (real("J_m", "1", "N.m"), "J_m in 'N.m'; expected 'kg.m2'"),
        (real("omega_max", "60", "rpm"), "omega_max in 'rpm'; expected 'rad/s'"),
        (real("J_m", "1 2 3"), "J_m: 3 values; expected 1"),
        ('name="J_m"><ssv:String value="1"/>', "J_m"),
        ('name="J_m"><ssv:Binary value="00"/>', "J_m is binary"),
        ('name="J_m"><ssv:String value="file:/etc/passwd"/>', "may not name files of this machine"),
    ):
        with pytest.raises(InputRefused, match=r"a\.ssv: ") as refused:
            parameters_of(ssv(parameter), "a.ssv", servo)
        assert told in str(refused.value)


def test_a_signal_is_held_or_on_lines_and_a_repeated_time_is_a_jump():
    found = series_of(b'"time","a.b"\n0,0\n1,2\n1,5\n2,5\n', "x")
    t = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 9.0])
    assert found.interpolate_at("a.b", t).tolist() == [0.0, 0.0, 1.0, 5.0, 5.0, 5.0]
    assert found.hold_at("a.b", t).tolist() == [0.0, 0.0, 0.0, 5.0, 5.0, 5.0]


def test_a_time_that_rounding_puts_below_a_row_sees_that_row():
    found = series_of(b"time,a\n0,0\n0.3,1\n0.6,2\n", "x")
    assert found.hold_at("a", 0.1 * np.array([3, 6]))[0] == 1.0 and 0.1 * 3 != 0.3
    assert found.hold_at("a", np.array([np.nextafter(0.3, 0.0)])).tolist() == [1.0]


def test_truth_values_are_numbers_and_words_are_left_out():
    found = series_of(b"time,a,s,v\n0,true,Set me!,1 2\n1,False,none,3 4\n", "x")
    assert found.signals["a"].tolist() == [1.0, 0.0] and found.others == ("s", "v")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "empty"),
        (b"time,a\n", "0 rows of numbers"),
        (b"time,a\n0,1\n1\n", "1 field, expected 2"),
        (b"time,a\n0,1\nx,2\n", "x line 3: time 'x'"),
        (b"time,a\n0,1\nnan,2\n", "time 'nan'"),
        (b"time,a\n0,1\n2,1\n1,1\n", "x line 4: time falls from 2 to 1 s"),
        (b"time,a\n0,1\n1,nan\n", "x line 3: a is 'nan'"),
        (b"time,a\n0,inf\n1,1\n", "x line 2: a is 'inf'"),
        (b"time,a,a\n0,1,1\n1,1,1\n", "two columns are named 'a'"),
        (b"a" + b",a" * 3000 + b"\n", "3,001 columns"),
        (b"PK\x03\x04", "ZIP archive"),
        (b"time,a\n0,\xff\n", "not UTF-8"),
    ],
)
def test_a_table_with_mistakes_is_refused_with_the_line(content: bytes, told: str):
    with pytest.raises(InputRefused) as refused:
        series_of(content, "x")
    assert told in str(refused.value)
