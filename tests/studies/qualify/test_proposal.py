import re
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin
from tests.conftest import ROOT
from tests.kernel.fmi.amplifier import parts_of_a_drive
from tests.kernel.fmi.archives import redescribed
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import described
from twin.kernel.ssp.structure import STRUCTURE_FILE
from twin.robot.assembly.drives import DrivePlan, plan_drive
from twin.robot.drive.mapping import AmbiguousRoles, Wiring, bindings
from twin.robot.experiment.drive_files import load_drive
from twin.studies.qualify.bench import response
from twin.studies.qualify.drive_list import listed_drives
from twin.studies.qualify.proposal import interpret_variables, part_names, parts_proposal, proposal, write_mapping


def test_an_unambiguous_drive_gets_a_complete_mapping_that_fits(velocity_servo: Path, tmp_path: Path):
    fmu = tmp_path / "servo.fmu"
    fmu.write_bytes(velocity_servo.read_bytes())
    text, complete = proposal(described(fmu))
    (tmp_path / "mapping.toml").write_text(text)
    assert complete
    plan = plan_drive(load_drive(str(tmp_path), tmp_path))
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
    command, found, certain = interpret_variables("motor.fmu", described(fmu).variables)
    assert (command, found.chosen["command"], certain) == ("voltage", "u_cmd", sure)
    text = parts_proposal({"motor": described(fmu)}, tmp_path)[0]
    assert 'command = "motor.u_cmd"' in text and "u_cmd = " not in text.partition("# Not connected")[2]


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
    except AmbiguousRoles as unclear:
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
    with pytest.raises(AmbiguousRoles, match=r'theta_m = "\?"'):
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
    drives = {shelved.name: shelved for shelved in listed_drives(root / "experiments")}
    servo = drives["velocity_servo"]
    assert (servo.kind, servo.command, servo.fmi, servo.problem) == ("servo", "velocity", "2.0", "")
    assert servo.description.startswith("Velocity servo: first-order lag")
    assert (drives["brushed_dc"].kind, drives["brushed_dc"].command) == ("motor", "voltage")
    assert drives["torque_motor_fmi3"].fmi == "3.0"


def test_a_drive_that_does_not_fit_is_listed_with_its_reason(velocity_servo: Path, tmp_path: Path):
    folder = tmp_path / "fmus" / "odd"
    folder.mkdir(parents=True)
    redescribed(velocity_servo, folder / "odd.fmu", 'causality="input"', 'causality="parameter"')
    (odd,) = listed_drives(tmp_path)
    assert odd.kind == "" and "omega_ref" in odd.problem


def test_a_folder_without_a_shelf_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin.robot.paths.PROJECT_FOLDER", tmp_path)
    with pytest.raises(InputRefused, match="no such folder"):
        listed_drives(tmp_path)


EXAMPLE = re.findall(
    r"```toml\n(.*?)```", (ROOT / "docs/drives.md").read_text().partition("## A drive of parts")[2], re.S
)
NAMESPACE = 'xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"'
FMUS = (("power stage", "resources/amplifier.fmu"), ("motor", "resources/motor.fmu"))
WIRE = 'startElement="power stage" startConnector="u_out" endElement="motor" endConnector="u"'
OUTSIDE = 'startConnector="u" endElement="power stage" endConnector="u_cmd"'


@pytest.fixture(scope="module")
def shop(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with amplifier.fmu and motor.fmu."""
    return parts_of_a_drive(root, tmp_path_factory.mktemp("shop"))


@pytest.fixture
def parts(shop: Path, tmp_path: Path) -> Path:
    """The same in a folder without a mapping."""
    for fmu in shop.glob("*.fmu"):
        (tmp_path / fmu.name).symlink_to(fmu)
    return tmp_path


def archive(shop: Path, file: Path, connections: list[str], head: str = "", fmus: object = FMUS) -> Path:
    """An SSP of a power stage and a motor."""
    elements = "".join(f'<ssd:Component name="{name}" source="{source}"/>' for name, source in fmus)  # type: ignore[attr-defined]
    lines = "".join(c if c.startswith("<") else f"<ssd:Connection {c}/>" for c in connections)
    with zipfile.ZipFile(file, "w") as target:
        target.writestr(
            STRUCTURE_FILE,
            f'<?xml version="1.0"?>{head}<ssd:SystemStructureDescription {NAMESPACE} name="x" version="1.0">'
            f'<ssd:System name="drive"><ssd:Elements>{elements}</ssd:Elements>'
            f"<ssd:Connections>{lines}</ssd:Connections></ssd:System></ssd:SystemStructureDescription>",
        )
        for name in ("amplifier", "motor"):
            target.write(shop / f"{name}.fmu", f"resources/{name}.fmu")
    return file


def plan_of(mapping: Path, **changes: object) -> DrivePlan:
    return plan_drive(load_drive(str(mapping), mapping.parent).model_copy(update=changes))


def with_gains(mapping: Path) -> Path:
    """The mapping with the gains that it leaves open as they stand there."""
    mapping.write_text(re.sub(r"^# (kp|ki|limit|period_ms)", r"\1", mapping.read_text(), flags=re.M))
    return mapping


def test_names_and_units_wire_an_amplifier_to_its_motor_and_leave_the_gains(parts: Path):
    done = twin("drive", "new", "amplifier.fmu", "motor.fmu", cwd=parts)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "mapping.toml" and "NOT complete" in done.stdout
    said = tomllib.loads((parts / "mapping.toml").read_text())
    assert said["wires"] == {"motor.u": "amplifier.u_out"}
    assert said["command"] == "voltage"
    assert said["inputs"]["command"] == "amplifier.u_cmd" and said["inputs"]["tau_load"] == "motor.M_load"
    assert (said["outputs"]["theta_m"], said["outputs"]["omega_m"]) == ("motor.phi", "motor.n")
    plan = plan_of(with_gains(parts / "mapping.toml"))
    assert plan.wires == (("amplifier.u_out", "motor.u"),)
    again = twin("drive", "new", "amplifier.fmu", "motor.fmu", cwd=parts)
    assert again.returncode == 2 and "never overwritten" in again.stderr


def test_a_wire_that_might_be_two_stands_as_comments(parts: Path, root: Path):
    mapping, complete = write_mapping(
        [str(parts / "amplifier.fmu"), str(root / "fmus/modelica_dc/modelica_dc.fmu")], parts
    )
    text = mapping.read_text()
    assert not complete and "wires" in tomllib.loads(text) and not tomllib.loads(text)["wires"]
    assert '# "modelica_dc.v_a" = "amplifier.u_out"   # [V] <- [V], perhaps' in text
    assert '# "modelica_dc.v_f" = "amplifier.u_out"   # [V] <- [V], perhaps' in text


def test_the_wires_of_an_ssp_are_those_of_its_structure(shop: Path, tmp_path: Path):
    scaled = (
        '<ssd:Connection startElement="motor" startConnector="i_a" endElement="motor" endConnector="v_bus">'
        '<ssd:LinearTransformation factor="2.0"/></ssd:Connection>'
    )
    lost = 'startElement="power stage" startConnector="nothing" endElement="motor" endConnector="v_bus"'
    ssp = archive(shop, tmp_path / "servo.ssp", [OUTSIDE, WIRE, WIRE, lost, scaled])
    mapping, complete = write_mapping([str(ssp)], tmp_path)
    text = mapping.read_text()
    assert not complete and {file.name for file in (tmp_path / "servo").iterdir()} == {
        "power_stage.fmu", "motor.fmu", "mapping.toml",
    }  # fmt: skip
    assert tomllib.loads(text)["wires"] == {"motor.u": "power_stage.u_out"}
    assert "# [V] <- [V], it is wired already" in text
    assert "# [V] <- ?, power_stage.nothing does not exist" in text
    assert "it has a LinearTransformation" in text
    assert plan_of(with_gains(tmp_path / "servo" / "mapping.toml")).wires == (("power_stage.u_out", "motor.u"),)


@pytest.mark.parametrize(
    ("head", "fmus", "sentence"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]>', FMUS, "it has a document type"),
        ("<open>", FMUS, "not valid XML: "),
        ("", (("motor", "../motor.fmu"),), "part 'motor' is not an FMU inside this archive (../motor.fmu)"),
        ("", (("motor", "http://x/motor.fmu"),), "not an FMU inside this archive"),
        ("", (), "0 parts; expected 1 to 50"),
        ("", [(str(n), "resources/motor.fmu") for n in range(60)], "60 parts"),
        ("", FMUS * 2, "two elements of system 'drive' are called 'power stage'"),
    ],
)
def test_a_structure_that_cannot_be_trusted_or_used_is_refused(
    shop: Path, tmp_path: Path, head: str, fmus: object, sentence: str
):
    with pytest.raises(InputRefused) as refused:
        write_mapping([str(archive(shop, tmp_path / "bad.ssp", [WIRE], head, fmus))], tmp_path)
    assert str(refused.value).startswith(f"{tmp_path / 'bad.ssp'}: ") and sentence in str(refused.value)


def test_parts_are_called_after_their_files_and_never_alike():
    assert part_names(map(Path, ["a b.fmu", "x/a.b.fmu", "a_b.fmu", "-.fmu"])) == ["a_b", "a_b_2", "a_b_3", "part"]


@pytest.fixture
def example(parts: Path) -> Path:
    (text,) = EXAMPLE[:1]
    (parts / "mapping.toml").write_text(text)
    return parts / "mapping.toml"


def turned(plan: DrivePlan, omega_ref: float, seconds: float = 1.0) -> np.ndarray:
    """Angle (ticks,) of the contract's shaft, commanded with a speed from rest."""
    ticks = round(1e3 * seconds)
    return response(plan, np.full(ticks, omega_ref), np.zeros(ticks)).theta_m


def test_the_example_of_the_page_turns_as_it_is_told(example: Path):
    theta_m = turned(plan_of(example), 0.5)
    # an integrator leaves no error; 1 %: ripple of its bridge
    assert theta_m[-1] - theta_m[-501] == pytest.approx(0.5 * 0.5, rel=0.01)


def test_gains_act_on_the_robots_shaft_so_a_gear_asks_for_larger_ones(example: Path):
    plan = plan_of(example)
    loop = plan.table.velocity_loop
    assert loop is not None
    faster = loop.model_copy(update={"kp": 20.0 * loop.kp, "ki": 20.0 * loop.ki})
    geared = turned(plan_of(example, gear_ratio=20.0, velocity_loop=faster), 0.05)
    # rounding, which the steps of the bridge's duty may turn into one of 24 V / 1024 for a while
    np.testing.assert_allclose(20.0 * geared, turned(plan, 1.0), atol=1e-3)


def test_a_voltage_turns_over_with_the_sign(example: Path):
    # the motor is the same both ways
    np.testing.assert_allclose(turned(plan_of(example, sign=-1), 0.5), turned(plan_of(example), 0.5), atol=1e-3)
