from pathlib import Path

import pytest
from pydantic import ValidationError

from tests.laws.runs import FORCE
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import ROLE_CONTRACTS
from twin.robot.experiment.drive_files import joint_tables, load_drive
from twin.robot.experiment.schema import Drive
from twin.robot.experiment.source import RETAINED_KEYS


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with fmus/acme (with a mapping) and fmus/plain (without)."""
    for name in ("acme", "plain"):
        folder = tmp_path / "fmus" / name
        folder.mkdir(parents=True)
        (folder / f"{name}.fmu").touch()
    (tmp_path / "fmus/acme/mapping.toml").write_text(
        'fmu = "acme.fmu"\nsign = -1\n[inputs]\nomega_ref = "n"\n[parameters]\nJ = 1.0\nR = 2.0\n'
    )
    return tmp_path


def test_a_drive_folder_brings_its_mapping_and_the_experiment_has_the_last_word(shelf: Path):
    (table, *_) = joint_tables({"fmu": "fmus/acme", "parameters": {"R": 3.0}}, shelf)
    assert table == {
        "fmu": str(shelf / "fmus/acme/acme.fmu"),
        "sign": -1,
        "inputs": {"omega_ref": "n"},
        "parameters": {"J": 1.0, "R": 3.0},
    }


def test_a_mapping_file_can_be_named_itself(shelf: Path):
    (table, *_) = joint_tables({"fmu": "fmus/acme/mapping.toml"}, shelf)
    assert table["fmu"] == str(shelf / "fmus/acme/acme.fmu")


def test_a_joint_that_names_another_drive_takes_nothing_of_the_common_one(shelf: Path):
    drive = {"fmu": "fmus/acme", "sign": 1, "joint_2": {"fmu": "fmus/plain"}, "joint_3": {"sign": -1}}
    one, two, three = joint_tables(drive, shelf)
    assert two == {"fmu": str(shelf / "fmus/plain/plain.fmu")}
    assert (one["sign"], three["sign"]) == (1, -1)


def test_a_drive_can_be_named_by_its_name_on_the_shelf(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    assert load_drive("acme", shelf).sign == -1
    assert load_drive("fmus/plain", shelf).sign == 1


def test_what_is_no_drive_is_refused(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    with pytest.raises(InputRefused, match="no such drive"):
        load_drive("nowhere", shelf)
    with pytest.raises(InputRefused, match=r"plian.fmu: no such FMU; did you mean '.*fmus/plain/plain.fmu'\?$"):
        load_drive("fmus/plain/plian.fmu", shelf)
    with pytest.raises(InputRefused, match=r"^plian: no such drive; did you mean 'plain'\?$"):
        load_drive("plian", shelf)
    with pytest.raises(InputRefused, match="a folder without"):
        load_drive("fmus", shelf)


def test_a_mapping_with_a_mistake_is_told(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    (shelf / "fmus/acme/mapping.toml").write_text('fmu = "acme.fmu"\nsigns = -1\n')
    with pytest.raises(InputRefused, match="unknown key 'signs'; did you mean 'sign'"):
        load_drive("acme", shelf)


@pytest.fixture
def motor(shelf: Path) -> Path:
    """A folder with a mapping of two parts."""
    for name in ("machine", "inverter"):
        (shelf / f"{name}.fmu").touch()
    (shelf / "motor.toml").write_text(
        '[parts.machine]\nfmu = "machine.fmu"\n[parts.machine.parameters]\n"motor.R" = 1.0\nL = 2.0\n'
        '[parts.inverter]\nfmu = "inverter.fmu"\n[parameters]\ninverter.delay = 3.0\n'
    )
    return shelf


def part_parameters(drive: dict[str, object], folder: Path) -> dict[str, dict[str, float]]:
    (table, *_) = joint_tables(drive, folder)
    assert "parameters" not in table
    return {name: part.get("parameters", {}) for name, part in table["parts"].items()}


@pytest.mark.parametrize(
    "given", [{"parameters": {"machine.motor.R": 9.0}}, {"parts": {"machine": {"parameters": {"motor.R": 9.0}}}}]
)
def test_a_parameter_of_a_part_lies_over_the_mappings_own(motor: Path, given: dict[str, object]):
    found = part_parameters({"fmu": "motor.toml", **given}, motor)
    assert found == {"machine": {"motor.R": 9.0, "L": 2.0}, "inverter": {"delay": 3.0}}


def test_a_joint_changes_a_parameter_of_a_part_of_the_common_drive(motor: Path):
    drive = {"fmu": "motor.toml", "joint_2": {"parts": {"machine": {"parameters": {"L": 7.0}}}}}
    assert [table["parts"]["machine"]["parameters"]["L"] for table in joint_tables(drive, motor)] == [2.0, 7.0, 2.0]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"nonsense": 3.0}, r"nonsense: this drive is made of parts; write machine.nonsense or inverter.nonsense"),
        ({"motr.R": 3.0}, r"motr.R: this drive is made of parts; write machine.R or inverter.R"),
    ],
)
def test_a_parameter_of_no_part_is_refused(motor: Path, given: dict[str, float], said: str):
    with pytest.raises(InputRefused, match=said):
        joint_tables({"fmu": "motor.toml", "parameters": given}, motor)


def test_a_parameter_is_not_given_twice(motor: Path):
    drive = {"fmu": "motor.toml", "parameters": {"machine.L": 1.0}, "parts": {"machine": {"parameters": {"L": 2.0}}}}
    with pytest.raises(InputRefused, match=r"machine.L and \[drive.parts.machine.parameters\] L: keep one"):
        joint_tables(drive, motor)


@pytest.mark.parametrize(
    "wrong", [{"parts": 3}, {"parts": {"machine": 3}}, {"parts": {"machine": {"parameters": 3}}}, {"parameters": 3}]
)
def test_what_is_no_table_is_left_for_the_schema_to_refuse(motor: Path, wrong: dict[str, object]):
    (table, *_) = joint_tables({"fmu": "motor.toml", "parameters": {"machine.L": 1.0}, **wrong}, motor)
    with pytest.raises(ValidationError):
        Drive.model_validate(table)


MINE = "class Controller:\n    pass\n"
CONTROLLER = '[controller]\npython = "mine.py:Controller"\n'


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    return file


def experiment(folder: Path, text: str) -> Path:
    file = folder / "with_mine.toml"
    file.write_text(f'extends = "{FORCE}.toml"\n{text}')
    return file


def test_a_part_of_the_robot_has_the_same_name_everywhere():
    assert RETAINED_KEYS.keys() == ROLE_CONTRACTS.keys()


def test_a_class_is_found_beside_the_file_and_takes_the_gains_of_the_files_below_with_it(tmp_path: Path, mine: Path):
    text = CONTROLLER + '[controller.parameters]\n"k.p" = 3.0\n'
    loaded = load_experiment(experiment(tmp_path, text), [])
    table = loaded.stand_ins["controller"]
    assert (table.file, table.class_name, table.label) == (mine, "Controller", "mine.py:Controller")
    assert table.parameters == {"k.p": 3.0}
    assert loaded.values["controller"].keys() == {"python", "parameters", *RETAINED_KEYS["controller"]} - {
        "delay_ticks", "bus_delay_ticks", "dead_zone_deg", "energy_tank"
    }  # fmt: skip
    assert loaded.controller.period == 0.002
    assert not [key for key in loaded.origins if key.startswith(("controller.force", "controller.position"))]


def test_twins_own_controller_leaves_everything_as_it_was():
    assert load_experiment(FORCE).stand_ins == {}


def test_the_command_line_may_name_the_part_after_its_parameters(mine: Path):
    loaded = load_experiment(FORCE, ["controller.parameters.kp=3", f"controller.python={mine}:Controller"])
    assert loaded.stand_ins["controller"].parameters == {"kp": 3.0}


def test_another_make_on_the_command_line_takes_the_place_of_the_files(tmp_path: Path, mine: Path):
    text = '[controller]\nfmu = "fmus/parts/paper_law"\n[controller.parameters]\nforce_kp = 0.003\n'
    loaded = load_experiment(experiment(tmp_path, text), [f"controller.python={mine}:Controller"])
    assert loaded.stand_ins["controller"].fmu is None
    assert loaded.stand_ins["controller"].parameters == {}


def test_a_mapping_beside_an_fmu_is_read():
    loaded = load_experiment(FORCE, ["controller.fmu=fmus/parts/paper_law"])
    assert loaded.stand_ins["controller"].inputs == {"p_ref_B": ("way_1", "way_2", "way_3")}


def test_a_monitor_that_is_switched_off_is_none(mine: Path):
    named = ["monitor.enabled=false", f"monitor.python={mine}:Controller"]
    assert load_experiment("pressing", named).stand_ins == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            CONTROLLER + 'mode = "position"',
            r"\[controller\] mode: of twin's own controller, and python = .mine.py:Controller. is another one",
        ),
        (
            CONTROLLER + '[controller.force]\nkp_mm_per_N = 3\n[controller.position]',
            r"\[controller\] (force, position|position, force): of twin's own .* remove them",
        ),
        (CONTROLLER + 'period = 2', "unknown key 'period'; did you mean 'period_ms'"),
        (CONTROLLER + 'fmu = "fmus/parts/paper_law"', "expected either fmu = .* or python"),
        ('[controller]\npython = "mine.py"', 'python = "mine.py": expected "FILE:CLASS"'),
        ('[controller]\npython = "yours.py:Controller"', "no file .*yours.py"),
        (CONTROLLER + 'tolerance = 1e-9', "python: tolerance are an FMU's"),
        ('[controller]\nfmu = "nowhere_near"', "nowhere_near: no such"),
        ('[estimator]\nperiod_ms = 2.0', "unknown key 'period_ms'"),
        ("[estimator]", "expected either fmu"),
        ('[scale]\npython = "mine.py:Controller"\nresolution_g = 5.0', r"\[scale\] resolution_g: of twin's own scale"),
        ('[monitor]\npython = "mine.py:Controller"\nforce_limit_N = 9.0', r"\[monitor\] force_limit_N: of twin's own"),
        (
            '[body]\npython = "mine.py:Controller"\n[contact.breathing]\namplitude_mm = 1.0\nrate_per_min = 12.0',
            "contact.breathing.*: moves the surface, and so does",
        ),
        (
            CONTROLLER + '[[change]]\nt_s = 8\nkey = "controller.force.reference_N"\nvalue = 6',
            "does not act in this experiment",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_in_a_sentence(tmp_path: Path, mine: Path, text: str, said: str):
    with pytest.raises(InputRefused, match=said):
        load_experiment(experiment(tmp_path, text), [])
