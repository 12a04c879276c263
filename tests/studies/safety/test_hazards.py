"""What a hazard table may say, and what is refused by name."""

from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.studies.safety.hazards import read_hazards

HEAD = 'title = "T"\nuse = "U"\nexperiment = "pressing"\nhead_radius_mm = 10.0\n'
LINE = """
[[hazard]]
id = "H1"
hazard = "One drive"
harm = "pain"
severity = "minor"
causes = [{ fault = "drive_runaway", target = "all drives" }]
limit_N = 22.5
control = "monitor"
residual = "little"
"""
EVIDENCE = '[hazard.evidence]\nbodies = ["scale"]\nsearch = 0\n'


def read(folder: Path, text: str):
    file = folder / "table.toml"
    file.write_text(text)
    return read_hazards(file)


def test_the_shipped_table_has_limits_causes_and_evidence(root: Path):
    table = read_hazards(root / "experiments" / "safety" / "massage.toml")
    assert [hazard.table.id for hazard in table.hazards] == [f"H{n}" for n in range(1, 9)]
    assert all(hazard.evidence.bodies for hazard in table.hazards)
    assert sum(threshold.has_publication for threshold in table.thresholds) >= 2 and table.sensitivity is not None
    after_a_trip = [hazard.table.id for hazard in table.hazards for cause in hazard.causes if cause.ordered]
    assert after_a_trip == [*(f"H{n}" for n in range(1, 6)), "H6", "H6", "H6", "H7"]
    assert all(threshold.source for threshold in table.thresholds)


def test_a_line_is_read_as_it_stands(tmp_path: Path):
    (hazard,) = read(tmp_path, HEAD + LINE + EVIDENCE).hazards
    assert hazard.causes[0].faults == (("drive_runaway", "all drives"),)
    assert (hazard.limit_key, hazard.limit, hazard.limit_text) == ("limit_N", 22.5, "peak force of 22.5 N")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (HEAD + LINE, r'\[\[hazard\]\] "H1": no evidence'),
        (HEAD + LINE.replace("limit_N", "limit") + EVIDENCE, r'"H1" limit: a limit without a unit'),
        (HEAD + LINE.replace("limit_N = 22.5\n", "") + EVIDENCE, r'"H1": no limit; expected one of limit_N'),
        (HEAD + LINE.replace("22.5", "-1") + EVIDENCE, r'"H1" limit_N = -1: expected a positive number'),
        (
            HEAD + LINE.replace("drive_runaway", "drive_runway") + EVIDENCE,
            "no kind of fault states it: .*drive_runaway",
        ),
        (HEAD + LINE.replace("all drives", "all wheels") + EVIDENCE, "no kind of fault states it: target"),
        (HEAD + LINE.replace("fault =", "cause =") + EVIDENCE, r'"H1" cause .*expected fault ='),
        (HEAD + LINE + EVIDENCE + LINE + EVIDENCE, 'id = "H1": given twice'),
        (
            HEAD
            + LINE.replace(" }]", ', and = { fault = "sample_loss" }, then = { fault = "belief_eta" } }]')
            + EVIDENCE,
            "one of and =, then =",
        ),
        (HEAD, "none; expected at least one line"),
        (HEAD + LINE.replace('harm = "pain"\n', "") + EVIDENCE, "missing key 'harm'"),
        (HEAD + LINE.replace("{ fault", '{ requirement = "always", fault') + EVIDENCE, "expected fault ="),
    ],
)
def test_what_is_missing_or_wrong_is_refused_by_name(tmp_path: Path, text: str, sentence: str):
    with pytest.raises(InputRefused, match=sentence):
        read(tmp_path, text)


@pytest.mark.parametrize(("word", "ordered"), [("and", False), ("then", True)])
def test_a_second_fault_begins_with_the_first_or_after_its_trip(tmp_path: Path, word: str, ordered: bool):
    text = LINE.replace(" }]", f', {word} = {{ fault = "sample_loss" }} }}]')
    ((cause,),) = (hazard.causes for hazard in read(tmp_path, HEAD + text + EVIDENCE).hazards)
    assert [kind for kind, _ in cause.faults] == ["drive_runaway", "sample_loss"] and cause.ordered is ordered
    assert (", then " in str(cause)) is ordered


@pytest.mark.parametrize("keys", ["", "pressure_kPa = 130.0\nforce_N = 30.0\n"])
def test_a_threshold_of_pain_is_a_pressure_or_a_force(tmp_path: Path, keys: str):
    threshold = f'[[threshold]]\nname = "arm"\nsource = "assumed: here"\n{keys}'
    with pytest.raises(InputRefused, match="expected one of pressure_kPa, force_N"):
        read(tmp_path, HEAD + threshold + LINE + EVIDENCE)


def test_all_mistakes_are_in_one_answer(tmp_path: Path):
    with pytest.raises(InputRefused) as refused:
        read(tmp_path, HEAD + LINE.replace("limit_N", "limit"))
    assert len(str(refused.value).splitlines()) == 2
