from pathlib import Path

import pytest

from tests.drive.archives import carrying
from twin.archive import content_of
from twin.errors import InputRefused
from twin.files import LIMIT
from twin.studies.reference.related import HOME, MANIFEST, MOST_RELATED, related

NAMED = (
    'xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" '
    'fmi-ls:fmi-ls-version="1.0.0-alpha.1"'
)


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def manifest(*sources: str) -> str:
    listed = "".join(f'<Related source="{source}" role="model" type="text/plain"/>' for source in sources)
    return f"<fmiReferences {NAMED}>{listed}</fmiReferences>"


def test_an_fmu_without_a_manifest_lists_nothing(servo: Path, tmp_path: Path):
    assert related(carrying(servo, tmp_path / "a.fmu", {})) == ()


def test_a_file_is_listed_with_role_labels_and_its_entry(servo: Path, tmp_path: Path):
    text = (
        f'<fmiReferences {NAMED}><Related source="a%20b.mo" role="model" type="text/modelica" description="the model">'
        '<Label name="os:Linux"/></Related></fmiReferences>'
    )
    (one,) = related(carrying(servo, tmp_path / "a.fmu", {MANIFEST: text, f"{HOME}/a b.mo": "model"}))
    assert (one.role, one.type, one.description, one.labels) == ("model", "text/modelica", "the model", ("os:Linux",))
    assert content_of(tmp_path / "a.fmu", one.entry) == b"model"


def test_a_source_is_a_file_of_the_fmu_or_none(servo: Path, tmp_path: Path):
    inside = ["../../modelDescription.xml", "./fmi-ls-manifest.xml", "../../sources/../modelDescription.xml#part"]
    outside = [
        "nothing.csv", "../../../etc/passwd", "../../../../modelDescription.xml", "/etc/passwd",
        "/modelDescription.xml", "file:///etc/passwd", "http://example.org/modelDescription.xml",
        "..%2F..%2F..%2Fetc%2Fpasswd", "C:/x", "..",
    ]  # fmt: skip
    listed = related(carrying(servo, tmp_path / "a.fmu", {MANIFEST: manifest(*inside, *outside)}))
    assert [bool(one.entry) for one in listed] == [True] * len(inside) + [False] * len(outside)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<fmiReferences/>", "expected <fmiReferences> of 'org.fmi-standard.fmi-ls-ref'"),
        (manifest("x").replace("fmiReferences", "other"), "<other>"),
        (manifest(""), "without a source"),
        (manifest(*["x"] * (MOST_RELATED + 1)), f"expected at most {MOST_RELATED}"),
        (f'<!DOCTYPE x [<!ENTITY y SYSTEM "/etc/passwd">]>{manifest("&y;")}', "DOCTYPE"),
        ("not XML", "not valid XML"),
        (" " * (LIMIT + 1), "expected at most 10 MB"),
    ],
)
def test_a_manifest_that_is_none_is_refused_in_a_sentence(servo: Path, tmp_path: Path, text: str, told: str):
    file = carrying(servo, tmp_path / "a.fmu", {MANIFEST: text})
    with pytest.raises(InputRefused, match=MANIFEST) as refused:
        related(file)
    assert told in str(refused.value) and "\n" not in str(refused.value)
