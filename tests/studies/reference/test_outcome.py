"""Experiments that come with an FMU: the servo's steady speed is omega_ref - droop tau_load, whoever runs it."""

from pathlib import Path

import pytest

from tests.drive.archives import carrying, redescribed
from tests.drive.faulty import faulty_drive
from tests.drive.test_related import NAMED
from tests.studies.reference.test_parameter_set import real, ssv
from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.files import LIMIT
from twin.studies.reference.bare_run import MOST_STEPS
from twin.studies.reference.drive import came_with
from twin.studies.reference.outcome import Outcome, References, references
from twin.studies.reference.related import HOME, MANIFEST
from twin.studies.reference.text import references_text

SSV, EXP = "application/x-ssp-parameter-set", "application/x-ma-ls-experiments"
FILES = {
    "p.ssv": ssv(real("droop", "1.2")).decode(),
    "in.csv": "time,omega_ref,tau_load\n0,0.5,0.1\n1,0.5,0.1\n",
    "ref.csv": "time,omega_m\n0,0\n0.8,0.38\n1,0.38\n",
    "e.exp": (
        '<Experiments name="e"><Experiment name="steady" startTime="0" stopTime="1" stepSize="0.001">'
        '<Parameters source="p.ssv"/><Stimuli source="in.csv"/><References source="ref.csv"/>'
        "</Experiment></Experiments>"
    ),
}
LISTED = (
    f'<Related source="e.exp" role="experiment" type="{EXP}"/><Related source="p.ssv" role="parameter" type="{SSV}"/>'
    '<Related source="ref.csv" role="result" type="text/csv"/>'
)


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def found(servo: Path, folder: Path, listed: str = LISTED, /, **changed: str | None) -> References:
    """What comes of `FILES`, some of them changed or left out (None), keys with _ for the dot."""
    files = FILES | {name.replace("_", "."): content for name, content in changed.items()}
    entries: dict[str, str | bytes] = {f"{HOME}/{name}": text for name, text in files.items() if text is not None}
    manifest = f"<fmiReferences {NAMED}>{listed}</fmiReferences>"
    done = references(carrying(servo, folder / "a.fmu", {MANIFEST: manifest, **entries}), apart=False)
    assert done is not None
    return done


def outcome(servo: Path, folder: Path, **changed: str | None) -> Outcome:
    (one,) = found(servo, folder, **changed).outcomes
    return one


def test_an_fmu_that_does_what_its_results_say_agrees(servo: Path, tmp_path: Path):
    done = found(servo, tmp_path)
    (one,) = done.outcomes
    assert (one.experiment, one.word) == ("steady", "agrees") and done.holds
    assert one.deviations["omega_m"] < 1e-6
    text = references_text([done])
    assert "a tolerance of ours" in " ".join(text.split()) and max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    "changed",
    [
        {"ref_csv": FILES["ref.csv"].replace("0.38", "0.39")},
        {"p_ssv": ssv(real("droop", "1.0")).decode()},
        {"e_exp": FILES["e.exp"].replace('<Parameters source="p.ssv"/>', "")},
        {"in_csv": FILES["in.csv"].replace("0.5", "0.45")},
    ],
)
def test_other_results_parameters_or_inputs_differ(servo: Path, tmp_path: Path, changed: dict[str, str]):
    words = [one.word for one in found(servo, tmp_path, **changed).outcomes]
    assert "differs" in words


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"p_ssv": None}, "p.ssv: not in the FMU"),
        ({"ref_csv": None}, "ref.csv: not in the FMU"),
        ({"p_ssv": ssv(real("drop", "1")).decode()}, "did you mean 'droop'?"),
        ({"in_csv": FILES["in.csv"].replace("tau_load", "tau")}, "column 'tau' is no input of numbers"),
        ({"in_csv": "time,omega_ref\n0,nan\n1,1\n"}, "omega_ref is 'nan'"),
        ({"in_csv": " " * (LIMIT + 1)}, "expected at most 10 MB"),
        ({"e_exp": "<other/>"}, "expected <Experiments>"),
        ({"e_exp": FILES["e.exp"].replace('stopTime="1"', 'stopTime="x"')}, "stopTime = 'x'; expected a finite number"),
        ({"e_exp": FILES["e.exp"].replace('stopTime="1"', 'stopTime="1e9"')}, f"expected 1 to {MOST_STEPS} of them"),
        ({"e_exp": FILES["e.exp"].replace('stepSize="0.001"', 'stepSize="0"')}, "steps of 0 s"),
        ({"e_exp": FILES["e.exp"].replace('startTime="0"', 'startTime="1"')}, "starts at 1 s; expected 0 s"),
        ({"e_exp": FILES["e.exp"].replace("in.csv", "../../../../etc/passwd.csv")}, "not in the FMU"),
        ({"e_exp": FILES["e.exp"].replace("in.csv", "file:///etc/hosts")}, "is of type|not in the FMU"),
        ({"e_exp": FILES["e.exp"].replace('source="ref.csv"', 'source="r.h5" type="application/hdf5"')}, "hdf5"),
    ],
)
def test_what_is_missing_or_wrong_is_refused_in_a_sentence(
    servo: Path, tmp_path: Path, changed: dict[str, str | None], told: str
):
    done = found(servo, tmp_path, **changed)
    one = next(one for one in done.outcomes if one.word == "refused")
    assert any(part in one.detail for part in told.split("|")) and "\n" not in one.detail
    assert not done.holds


def test_results_and_parameters_without_an_experiment_are_tried_with_the_default_one(servo: Path, tmp_path: Path):
    results = '<Related source="ref.csv" role="result" type="text/csv"/>'
    listed = results + f'<Related source="p.ssv" role="parameter" type="{SSV}"/>'
    still = "time,omega_m,words\n0,0,a\n1,0,b\n"
    words = {one.experiment: one.word for one in found(servo, tmp_path, listed, ref_csv=still).outcomes}
    assert words == {"default experiment, ref.csv": "agrees", "default experiment, p.ssv": "ran"}


def test_what_is_in_no_form_that_is_read_is_named(servo: Path, tmp_path: Path):
    listed = '<Related source="e.exp" role="model"/><Related source="t.x" role="experiment/validation"/>'
    listed += '<Related source="in.csv" role="experiment" type="application/x-other"/>'
    done = found(servo, tmp_path, listed)
    assert dict(done.carried.unread).keys() == {"t.x", "in.csv"} and not done.outcomes and done.holds


def test_files_of_the_cross_check_beside_an_fmu_are_run(servo: Path, tmp_path: Path):
    file = carrying(servo, tmp_path / "a.fmu", {})
    assert references(file, apart=False) is None
    (tmp_path / "a_ref.csv").write_text('"time","omega_m"\n0.0,0.0\n0.4,0.44\n0.5,0.44\n')
    (tmp_path / "a_in.csv").write_text(FILES["in.csv"])
    (tmp_path / "a_ref.opt").write_text("StartTime, 0.0\nStopTime, 0.5\nStepSize, 0.0\nRelTol, 1e-4\n")
    done = references(file, apart=False)
    assert done is not None and done.outcomes[0].word == "agrees"
    assert "500 steps of 0.001 s" in done.outcomes[0].detail
    (tmp_path / "a_ref.opt").write_text("StopTime, many\n")
    with pytest.raises(InputRefused, match="StopTime = 'many'"):
        references(file, apart=False)


def test_an_fmu_that_is_no_drive_is_run_and_one_that_is_not_the_pinned_one_is_not(servo: Path, tmp_path: Path):
    other = redescribed(servo, tmp_path / "other.fmu", 'name="theta_m"', 'name="x"')
    done = found(other, tmp_path)
    assert done.outcomes[0].word == "agrees"
    (tmp_path / "mapping.toml").write_text(f'fmu = "a.fmu"\nsha256 = "{"0" * 64}"\n')
    with pytest.raises(InputRefused, match="sha256"):
        came_with(lone_drive(str(tmp_path / "mapping.toml"), tmp_path), apart=False)


def test_an_fmu_that_goes_wrong_fails_where_its_results_go_on(root: Path, tmp_path: Path):
    listed = LISTED.replace("p.ssv", "none.ssv")
    bad = faulty_drive(root, tmp_path)
    longer = {
        "e_exp": FILES["e.exp"].replace('stopTime="1"', 'stopTime="2"'),
        "p_ssv": ssv(real("droop", "2")).decode(),
    }
    longer["ref_csv"] = "time,omega_m\n0,0\n2,0\n"
    one = found(bad, tmp_path, listed, **longer).outcomes[0]
    assert one.word == "failed" and "omega_m" not in one.experiment
    ends = found(bad, tmp_path, listed, **longer | {"ref_csv": "time,omega_m\n0,0\n0.9,0\n"}).outcomes[0]
    assert ends.word == "agrees" and "as its results end" in ends.detail
