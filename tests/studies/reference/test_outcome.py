"""Experiments that come with an FMU: the servo's steady speed is omega_ref - droop tau_load, whoever runs it."""

from pathlib import Path

import pytest

from tests.kernel.fmi.archives import carrying, redescribed
from tests.kernel.fmi.faulty import faulty_drive
from tests.studies.reference.test_carried import NAMED, real, ssv
from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_TEXT_BYTES
from twin.robot.experiment.drive_files import load_drive
from twin.studies.reference.outcome import (
    MANIFEST_FILE,
    MANIFEST_FOLDER,
    MAX_STEPS,
    ReferenceOutcome,
    References,
    drive_references,
    references,
    references_text,
)

SSV = "application/x-ssp-parameter-set"
FILES = {
    "p.ssv": ssv(real("droop", "1.2")).decode(),
    "a_in.csv": "time,omega_ref,tau_load\n0,0.5,0.1\n1,0.5,0.1\n",
    "a_ref.csv": "time,omega_m\n0,0\n0.8,0.38\n1,0.38\n",
}
LISTED = (
    f'<Related source="p.ssv" role="parameter" type="{SSV}"/>'
    '<Related source="a_ref.csv" role="result" type="text/csv"/>'
)


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def found(servo: Path, folder: Path, listed: str = LISTED, /, **changed: str | None) -> References:
    """What comes of `FILES`, some of them changed or left out (None), keys with _ for the last dot."""
    files = FILES | {f"{name[:-4]}.{name[-3:]}": content for name, content in changed.items()}
    entries: dict[str, str | bytes] = {
        f"{MANIFEST_FOLDER}/{name}": text for name, text in files.items() if text is not None
    }
    manifest = f"<fmiReferences {NAMED}>{listed}</fmiReferences>"
    done = references(carrying(servo, folder / "a.fmu", {MANIFEST_FILE: manifest, **entries}), apart=False)
    assert done is not None
    return done


def outcome(servo: Path, folder: Path, **changed: str | None) -> ReferenceOutcome:
    (one,) = found(servo, folder, **changed).outcomes
    return one


def test_an_fmu_that_does_what_its_results_say_agrees(servo: Path, tmp_path: Path):
    done = found(servo, tmp_path)
    (one,) = done.outcomes
    assert (one.experiment, one.word) == ("a_ref.csv", "agrees") and done.holds
    assert one.deviations["omega_m"] < 1e-6
    text = references_text([done])
    assert "twin's default; the files have no tol" in " ".join(text.split()) and max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    "changed",
    [
        {"a_ref_csv": FILES["a_ref.csv"].replace("0.38", "0.39")},
        {"p_ssv": ssv(real("droop", "1.0")).decode()},
        {"p_ssv": None},
        {"a_in_csv": FILES["a_in.csv"].replace("0.5", "0.45")},
        {"a_in_csv": None},
    ],
)
def test_other_results_parameters_or_inputs_differ(servo: Path, tmp_path: Path, changed: dict[str, str]):
    words = [one.word for one in found(servo, tmp_path, **changed).outcomes]
    assert "differs" in words


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"p_ssv": ssv(real("drop", "1")).decode()}, "did you mean 'droop'?"),
        ({"a_in_csv": FILES["a_in.csv"].replace("tau_load", "tau")}, "column 'tau' is not a numeric input"),
        ({"a_in_csv": "time,omega_ref\n0,nan\n1,1\n"}, "omega_ref is 'nan'"),
        ({"a_in_csv": " " * (MAX_TEXT_BYTES + 1)}, "expected at most 10 MB"),
        ({"a_ref_csv": "time,omega_m\n0,0\n1,x\n"}, "omega_m is 'x'"),
    ],
)
def test_what_is_missing_or_wrong_is_refused_in_a_sentence(
    servo: Path, tmp_path: Path, changed: dict[str, str | None], told: str
):
    done = found(servo, tmp_path, **changed)
    one = next(one for one in done.outcomes if one.word == "refused")
    assert any(part in one.detail for part in told.split("|")) and "\n" not in one.detail
    assert not done.holds


def test_text_among_results_is_left_out_and_named(servo: Path, tmp_path: Path):
    results = '<Related source="a_ref.csv" role="result" type="text/csv"/>'
    still = "time,omega_m,words\n0,0,a\n1,0,b\n"
    (one,) = found(servo, tmp_path, results, a_ref_csv=still, a_in_csv=None).outcomes
    assert one.word == "agrees" and "not compared: words" in one.detail


def test_what_is_in_no_form_that_is_read_is_named(servo: Path, tmp_path: Path):
    listed = '<Related source="e.exp" role="model"/><Related source="t.x" role="experiment/validation"/>'
    listed += '<Related source="a_in.csv" role="experiment" type="application/x-other"/>'
    done = found(servo, tmp_path, listed)
    assert dict(done.reference_files.unread).keys() == {"t.x", "a_in.csv"} and not done.outcomes and done.holds


def test_files_of_the_cross_check_beside_an_fmu_are_run(servo: Path, tmp_path: Path):
    file = carrying(servo, tmp_path / "a.fmu", {})
    assert references(file, apart=False) is None
    (tmp_path / "a_ref.csv").write_text('"time","omega_m"\n0.0,0.0\n0.4,0.44\n0.5,0.44\n')
    (tmp_path / "a_in.csv").write_text(FILES["a_in.csv"])
    done = references(file, apart=False)
    assert done is not None and done.outcomes[0].word == "agrees"
    assert "1000 steps of 0.001 s" in done.outcomes[0].detail


def test_the_default_experiment_says_how_long_a_run_is(servo: Path, tmp_path: Path):
    good = carrying(servo, tmp_path / "a.fmu", {})
    stated = 'startTime="0.0" stopTime="1.0" stepSize="0.001"'
    for times, told in (
        ('stopTime="0.5" stepSize="0.002"', "250 steps of 0.002 s"),
        ('startTime="0.0"', "500 steps of 0.0008 s"),
        ('stopTime="1e9" stepSize="0.001"', f"expected 1 to {MAX_STEPS} of them"),
        ('stopTime="1" stepSize="2"', "steps of 2 s"),
        ('startTime="1" stopTime="2"', "starts at 1 s; expected 0 s"),
    ):
        redescribed(good, tmp_path / "b.fmu", stated, times)
        (tmp_path / "b_ref.csv").write_text("time,omega_m\n0,0\n0.4,0\n")
        done = references(tmp_path / "b.fmu", apart=False)
        assert done is not None and told in done.outcomes[0].detail


def test_an_fmu_that_is_no_drive_is_run_and_one_that_is_not_the_pinned_one_is_not(servo: Path, tmp_path: Path):
    other = redescribed(servo, tmp_path / "other.fmu", 'name="theta_m"', 'name="x"')
    done = found(other, tmp_path)
    assert done.outcomes[0].word == "agrees"
    (tmp_path / "mapping.toml").write_text(f'fmu = "a.fmu"\nsha256 = "{"0" * 64}"\n')
    with pytest.raises(InputRefused, match="sha256"):
        drive_references(load_drive(str(tmp_path / "mapping.toml"), tmp_path), apart=False)


def test_an_fmu_that_goes_wrong_fails_where_its_results_go_on(root: Path, tmp_path: Path):
    bad = faulty_drive(root, tmp_path)
    wrong = {"p_ssv": ssv(real("droop", "2")).decode(), "a_in_csv": None}
    one = found(bad, tmp_path, **wrong, a_ref_csv="time,omega_m\n0,0\n2,0\n").outcomes[0]
    assert one.word == "failed"
    ends = found(bad, tmp_path, **wrong, a_ref_csv="time,omega_m\n0,0\n0.9,0\n").outcomes[0]
    assert ends.word == "agrees" and "as its results end" in ends.detail
