"""Tables of parts of another make, as an experiment's file has them."""

from pathlib import Path

import pytest

from tests.laws.runs import FORCE
from twin.errors import InputRefused
from twin.experiment.replaced import KEPT
from twin.runs.assembly.load import load_experiment
from twin.runs.assembly.roles import CONTRACTS

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
    assert KEPT.keys() == CONTRACTS.keys()


def test_a_class_is_found_beside_the_file_and_takes_the_gains_of_the_files_below_with_it(tmp_path: Path, mine: Path):
    text = CONTROLLER + '[controller.parameters]\n"k.p" = 3.0\n'
    loaded = load_experiment(experiment(tmp_path, text), [])
    table = loaded.stand_ins["controller"]
    assert (table.file, table.class_name, table.label) == (mine, "Controller", "mine.py:Controller")
    assert table.parameters == {"k.p": 3.0}
    assert loaded.values["controller"].keys() == {"python", "parameters", *KEPT["controller"]} - {
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
        ('[controller]\nfmu = "nowhere"', "nowhere: no such"),
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
