import re
import tomllib
from pathlib import Path

import pytest

from tests.drive.archives import redescribed
from twin.drive.description import described
from twin.drive.mapping import RolesUnclear, Wiring, bindings
from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.runs.assembly.drives import planned
from twin.studies.qualify.parts_proposal import parts_proposal
from twin.studies.qualify.proposal import proposal, understood
from twin.studies.qualify.shelf import shelved_drives


def test_an_unambiguous_drive_gets_a_complete_mapping_that_fits(velocity_servo: Path, tmp_path: Path):
    fmu = tmp_path / "servo.fmu"
    fmu.write_bytes(velocity_servo.read_bytes())
    text, complete = proposal(described(fmu))
    (tmp_path / "mapping.toml").write_text(text)
    assert complete
    plan = planned(lone_drive(str(tmp_path), tmp_path))
    assert [b.name for b in plan.bindings] == ["omega_ref", "tau_load", "theta_m", "omega_m", "tau_motor"]
    assert plan.table.sha256 == plan.parts[""].sha256


def test_a_motor_gets_its_roles_and_the_gains_of_our_loop_as_comments(root: Path):
    text, complete = proposal(described(root / "fmus/brushed_dc/brushed_dc.fmu"))
    proposed = tomllib.loads(text)
    assert not complete
    assert proposed["command"] == "voltage"
    assert proposed["inputs"] == {"command": "u_cmd", "tau_load": "M_load", "v_bus": "v_bus"}
    assert proposed["outputs"]["theta_m"] == "phi"
    assert proposed["velocity_loop"] == {}
    assert "# kp = 0.1                # V per rad/s" in text


@pytest.mark.parametrize(("loads", "sure"), [(("tau_load", "tau_brake"), True), (("tau_1", "tau_2"), False)])
def test_a_motor_with_volts_and_two_torques_is_commanded_with_volts(
    root: Path, tmp_path: Path, loads: tuple[str, str], sure: bool
):
    """A lone torque is as good a load as a command; what is called like a command is one."""
    second = f'<ScalarVariable name="{loads[1]}" valueReference="99" causality="input" variability="continuous">'
    more = f'<ModelVariables>{second}<Real unit="N.m" start="0"/></ScalarVariable>'
    good = redescribed(root / "fmus/brushed_dc/brushed_dc.fmu", tmp_path / "volts.fmu", "<ModelVariables>", more)
    named = redescribed(good, tmp_path / "named.fmu", 'name="M_load"', f'name="{loads[0]}"')
    fmu = redescribed(named, tmp_path / "motor.fmu", "Torque the load asks of", "Torque at")
    command, found, certain = understood("motor.fmu", described(fmu).variables)
    assert (command, found.chosen["command"], certain) == ("voltage", "u_cmd", sure)
    text = parts_proposal({"motor": described(fmu)}, tmp_path)[0]
    assert 'command = "motor.u_cmd"' in text and "u_cmd = " not in text.partition("# Not fed")[2]


def test_every_doubtful_choice_stands_as_a_comment_and_no_choice_is_made(root: Path):
    text, complete = proposal(described(root / "fmus/modelica_dc/modelica_dc.fmu"))
    assert not complete
    assert '# command = "v_a"' in text and '# command = "v_f"' in text
    assert tomllib.loads(text)["inputs"] == {"tau_load": "tau_load"}


@pytest.mark.parametrize("drive", ["modelica_dc", "brushed_dc", "stepper", "torque_motor_fmi3"])
def test_the_file_and_the_sentence_of_a_refusal_propose_the_same(root: Path, drive: str):
    fmu = described(root / "fmus" / drive / f"{drive}.fmu")
    text, _ = proposal(fmu)
    try:
        bound = bindings("a.fmu", fmu.variables, Wiring())
    except RolesUnclear as unclear:
        said = str(unclear).partition("FMU:\n")[2]
        assert tomllib.loads(said)["drive"].get("command", "velocity") == tomllib.loads(text)["command"]
        choices = dict(re.findall(r'^(\w+) = "(.*)"', said.partition("[drive.inputs]")[2], re.M))
        others = {role: names.split(", ") for role, names in re.findall(r'^(\w+) = ".*"   # or: (.*)', said, re.M)}
        offered = {role: {first, *others.get(role, [])} for role, first in choices.items()}
    else:
        offered = {b.port.name: {b.name} for b in bound}
    written = re.findall(r'^(?:# )?(\w+) = "(.*?)"   #', text.partition("[inputs]")[2], re.M)
    assert {role: {name for other, name in written if other == role} for role, _ in written} == offered


def test_clocks_texts_and_currents_are_nobodys_angle(velocity_servo: Path, tmp_path: Path):
    outputs = (
        '<ScalarVariable name="angle_text" valueReference="90" causality="output" variability="discrete"><String/>'
        '</ScalarVariable><ScalarVariable name="angle_is_known" valueReference="91" causality="output" '
        'variability="discrete"><Boolean/></ScalarVariable></ModelVariables>'
    )
    more = redescribed(velocity_servo, tmp_path / "more.fmu", "</ModelVariables>", outputs)
    bad = redescribed(more, tmp_path / "bad.fmu", 'unit="rad"', 'unit="A"')
    text, complete = proposal(described(bad))
    assert not complete and '# theta_m = "?"' in text
    with pytest.raises(RolesUnclear, match=r'theta_m = "\?"'):
        bindings("bad.fmu", described(bad).variables, Wiring())


def test_a_description_of_several_lines_stays_a_comment(velocity_servo: Path, tmp_path: Path):
    odd = redescribed(
        velocity_servo, tmp_path / "odd.fmu", 'description="Motor angle', 'description="&#10;[x]&#10;Motor angle'
    )
    assert set(tomllib.loads(proposal(described(odd))[0])) >= {"inputs", "outputs"}
    assert "x" not in tomllib.loads(proposal(described(odd))[0])


def test_what_no_variable_can_be_is_said(velocity_servo: Path, tmp_path: Path):
    bad = redescribed(velocity_servo, tmp_path / "bad.fmu", 'name="theta_m" valueReference="2" causality="output"',
                      'name="theta_m" valueReference="2" causality="calculatedParameter"')  # fmt: skip
    text, complete = proposal(described(bad))
    assert not complete
    assert '# theta_m = "?"   # motor angle: no output measures rad' in text


def test_the_shelf_tells_what_each_drive_is(root: Path):
    drives = {shelved.name: shelved for shelved in shelved_drives(root / "experiments")}
    servo = drives["velocity_servo"]
    assert (servo.kind, servo.command, servo.fmi, servo.problem) == ("servo", "velocity", "2.0", "")
    assert servo.description.startswith("Velocity servo: first-order lag")
    assert (drives["brushed_dc"].kind, drives["brushed_dc"].command) == ("motor", "voltage")
    assert drives["torque_motor_fmi3"].fmi == "3.0"


def test_a_drive_that_does_not_fit_is_listed_with_its_reason(velocity_servo: Path, tmp_path: Path):
    folder = tmp_path / "fmus" / "odd"
    folder.mkdir(parents=True)
    redescribed(velocity_servo, folder / "odd.fmu", 'causality="input"', 'causality="parameter"')
    (odd,) = shelved_drives(tmp_path)
    assert odd.kind == "" and "omega_ref" in odd.problem


def test_a_folder_without_a_shelf_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin.places.HOME", tmp_path)
    with pytest.raises(InputRefused, match="no such folder"):
        shelved_drives(tmp_path)
