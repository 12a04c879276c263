"""Drives of several FMUs: what `twin drive new` writes, and the example of docs/drives.md."""

import re
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin
from tests.conftest import ROOT
from tests.drive.amplifier import parts_of_a_drive
from twin.cosim.ssp.structure import STRUCTURE
from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.runs.assembly.drives import DrivePlan, planned
from twin.studies.qualify.beginning import begun
from twin.studies.qualify.bench import response
from twin.studies.qualify.parts_proposal import part_names

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
            STRUCTURE,
            f'<?xml version="1.0"?>{head}<ssd:SystemStructureDescription {NAMESPACE} name="x" version="1.0">'
            f'<ssd:System name="drive"><ssd:Elements>{elements}</ssd:Elements>'
            f"<ssd:Connections>{lines}</ssd:Connections></ssd:System></ssd:SystemStructureDescription>",
        )
        for name in ("amplifier", "motor"):
            target.write(shop / f"{name}.fmu", f"resources/{name}.fmu")
    return file


def plan_of(mapping: Path, **changes: object) -> DrivePlan:
    return planned(lone_drive(str(mapping), mapping.parent).model_copy(update=changes))


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
    mapping, complete = begun([str(parts / "amplifier.fmu"), str(root / "fmus/modelica_dc/modelica_dc.fmu")], parts)
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
    mapping, complete = begun([str(ssp)], tmp_path)
    text = mapping.read_text()
    assert not complete and {file.name for file in (tmp_path / "servo").iterdir()} == {
        "power_stage.fmu", "motor.fmu", "mapping.toml",
    }  # fmt: skip
    assert tomllib.loads(text)["wires"] == {"motor.u": "power_stage.u_out"}
    assert "# [V] <- [V], it is wired already" in text
    assert "# [V] <- ?, there is no power_stage.nothing" in text
    assert "it has a LinearTransformation" in text
    assert plan_of(with_gains(tmp_path / "servo" / "mapping.toml")).wires == (("power_stage.u_out", "motor.u"),)


@pytest.mark.parametrize(
    ("head", "fmus", "sentence"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]>', FMUS, "it has a document type"),
        ("<open>", FMUS, "not valid XML: "),
        ("", (("motor", "../motor.fmu"),), "part 'motor' is no FMU inside this archive (../motor.fmu)"),
        ("", (("motor", "http://x/motor.fmu"),), "no FMU inside this archive"),
        ("", (), "0 parts; expected 1 to 50"),
        ("", [(str(n), "resources/motor.fmu") for n in range(60)], "60 parts"),
        ("", FMUS * 2, "two elements of system 'drive' are called 'power stage'"),
    ],
)
def test_a_structure_that_cannot_be_trusted_or_used_is_refused(
    shop: Path, tmp_path: Path, head: str, fmus: object, sentence: str
):
    with pytest.raises(InputRefused) as refused:
        begun([str(archive(shop, tmp_path / "bad.ssp", [WIRE], head, fmus))], tmp_path)
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
