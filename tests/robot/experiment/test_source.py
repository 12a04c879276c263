"""A file that is meant for something else than to be run says in one sentence what it is for."""

from math import radians
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.source import apply_overrides, read_source
from twin.robot.paths import locate_file


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("experiments/robots/massage_robot.toml", "a robot, not an experiment; twin init experiment.toml --robot"),
        ("experiments/bodies/back.toml", "a body, not an experiment; press on it with: twin run pressing --body"),
        ("experiments/sweeps/drives.toml", "a sweep, not an experiment; run it with: twin sweep"),
        ("fmus/modelica_dc/mapping.toml", "the mapping of a drive, not an experiment; use it with: twin run"),
    ],
)
def test_it_is_one_sentence(root: Path, file: str, told: str):
    with pytest.raises(InputRefused) as refusal:
        load_experiment(root / file)
    assert str(refusal.value).startswith(f"{root / file}: {told}") and "\n" not in str(refusal.value)


def test_every_robot_and_body_is_told_apart_and_no_experiment_is(root: Path):
    for folder in ("robots", "bodies", "sweeps"):
        for path in (root / "experiments" / folder).glob("*.toml"):
            with pytest.raises(InputRefused, match="not an experiment"):
                load_experiment(path)
    for path in (root / "experiments").glob("*.toml"):
        load_experiment(path)


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_a_file_is_laid_over_what_it_extends_key_by_key(tmp_path: Path):
    write(tmp_path, "base.toml", "a = 1\n[t]\nx = 1\ny = 2\n")
    child = write(tmp_path, "child.toml", 'extends = "base.toml"\n[t]\ny = 3\n')
    source = read_source(child)
    assert source.values == {"a": 1, "t": {"x": 1, "y": 3}}
    assert source.origins["t.x"] == "set in base.toml"
    assert source.origins["t.y"] == "set in child.toml"


def test_a_value_may_carry_its_source_and_loses_it_when_overridden(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", 'k = { value = 2.0, source = "Sec. II" }\n'))
    assert source.values == {"k": 2.0}
    assert source.origins["k"] == "Sec. II"
    apply_overrides(source, ["k=3.5"])
    assert source.values == {"k": 3.5}
    assert source.origins["k"] == "set on the command line"


def test_an_override_reads_toml_and_bare_words(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", ""))
    apply_overrides(source, ["a.b.c=[1, 2]", "mode=position", "flag=true"])
    assert source.values == {"a": {"b": {"c": (1, 2)}}, "mode": "position", "flag": True}


@pytest.mark.parametrize("text", ["novalue", "=3"])
def test_an_override_without_key_or_value_is_refused(tmp_path: Path, text: str):
    source = read_source(write(tmp_path, "e.toml", ""))
    with pytest.raises(InputRefused, match="expected key=value"):
        apply_overrides(source, [text])


@pytest.mark.parametrize("text", ["k=1_000", "k=1_0.5", "k=[1, 2_0]", "k=0x1_0"])
def test_an_override_with_underscores_in_numbers_is_refused(tmp_path: Path, text: str):
    source = read_source(write(tmp_path, "e.toml", "k = 1_000"))
    assert source.values == {"k": 1000}
    with pytest.raises(InputRefused, match="expected numbers without underscores"):
        apply_overrides(source, [text])
    apply_overrides(source, ["a_b=file_1_0.fmu", 'c=["x_1", 2]', "d=[{kind_1 = 2}]"])
    assert source.values["a_b"] == "file_1_0.fmu"


def test_files_that_extend_each_other_are_refused(tmp_path: Path):
    write(tmp_path, "a.toml", 'extends = "b.toml"')
    b = write(tmp_path, "b.toml", 'extends = "a.toml"')
    with pytest.raises(InputRefused, match="circle"):
        read_source(b)


def test_a_chain_of_files_may_be_32_long_and_is_read_once_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for number in range(1, 40):
        write(tmp_path, f"{number}.toml", f'extends = "{number + 1}.toml"\nk{number} = 1\n')
    write(tmp_path, "40.toml", "k40 = 1\n")
    read: list[Path] = []

    def noted(path: Path, *arguments: object) -> str:
        read.append(path)
        return path.read_text()

    monkeypatch.setattr("twin.robot.experiment.source.read_text", noted)
    assert len(read_source(tmp_path / "9.toml").values) == len(read) == 32
    with pytest.raises(InputRefused, match="extends a chain of more than 32 files"):
        read_source(tmp_path / "8.toml")


@pytest.mark.parametrize(
    ("content", "said"), [("a = ", "not valid TOML"), ("extends = 3", "expected the name of a TOML file")]
)
def test_what_cannot_be_read_is_refused_with_the_reason(tmp_path: Path, content: str, said: str):
    with pytest.raises(InputRefused, match=said):
        read_source(write(tmp_path, "e.toml", content))


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path):
    with pytest.raises(InputRefused, match="no such experiment"):
        read_source(tmp_path / "none.toml")
    with pytest.raises(InputRefused, match="a folder"):
        read_source(tmp_path)


def test_names_are_looked_up_from_the_experiments_folder_upwards(tmp_path: Path):
    inner = tmp_path / "experiments"
    inner.mkdir()
    (tmp_path / "fmus").mkdir()
    assert locate_file("fmus", inner) == tmp_path / "fmus"
    assert locate_file("nowhere_near", inner) == inner / "nowhere_near"


def test_what_lies_nowhere_near_is_taken_from_the_repository(root: Path, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert locate_file("fmus/pmsm_foc", tmp_path) == root / "fmus" / "pmsm_foc"
    assert locate_file("robots/massage_robot.toml", tmp_path) == root / "experiments/robots/massage_robot.toml"
    (tmp_path / "fmus" / "pmsm_foc").mkdir(parents=True)
    assert locate_file("fmus/pmsm_foc", tmp_path) == tmp_path / "fmus" / "pmsm_foc"


def test_another_drive_brings_its_own_parameters(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", '[drive]\nfmu = "x"\n[drive.parameters]\ndroop = 0.6\n'))
    source.select_file("drive", "fmu", "y.fmu")
    assert source.values["drive"].keys() == {"fmu"}
    assert not any(key.startswith("drive.parameters") for key in source.origins)


def test_a_file_that_names_another_drive_keeps_nothing_of_the_one_it_extends(tmp_path: Path):
    write(tmp_path, "base.toml", '[drive]\nfmu = "x"\n[drive.parameters]\ndroop = 0.6\n')
    other = write(tmp_path, "other.toml", 'extends = "base.toml"\n[drive]\nfmu = "y"\n')
    assert read_source(other).values["drive"] == {"fmu": "y"}
    tuned = write(tmp_path, "tuned.toml", 'extends = "base.toml"\n[drive.parameters]\ndroop = 0.3\n')
    assert read_source(tuned).values["drive"] == {"fmu": "x", "parameters": {"droop": 0.3}}


TWO_TASKS = """
[[task]]
kind = "press"
force_N = { value = 8.0, source = "a thumb" }
[[task]]
kind = "tap"
force_N = 3.0
"""


def test_an_array_of_tables_is_read_with_a_source_for_each_value(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", TWO_TASKS))
    assert source.values == {"task": ({"kind": "press", "force_N": 8.0}, {"kind": "tap", "force_N": 3.0})}
    assert source.origins["task.1.force_N"] == "a thumb"
    assert source.origins["task.2.force_N"] == "set in e.toml"


def test_an_array_of_tables_replaces_the_one_of_the_file_below_as_a_whole(tmp_path: Path):
    write(tmp_path, "base.toml", TWO_TASKS)
    child = write(tmp_path, "child.toml", 'extends = "base.toml"\n[[task]]\nkind = "roll"\n')
    source = read_source(child)
    assert source.values == {"task": ({"kind": "roll"},)}
    assert source.origins == {"task.1.kind": "set in child.toml"}


def test_one_value_of_one_table_of_an_array_can_be_overridden(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", TWO_TASKS))
    apply_overrides(source, ["task.1.force_N=5", "task.2.times=3"])
    assert source.values["task"] == ({"kind": "press", "force_N": 5}, {"kind": "tap", "force_N": 3.0, "times": 3})
    assert source.origins["task.1.force_N"] == "set on the command line"
    assert source.origins["task.1.kind"] == "set in e.toml"


def test_a_file_lays_one_table_over_one_of_the_array_that_it_extends(tmp_path: Path):
    write(tmp_path, "base.toml", TWO_TASKS)
    child = write(tmp_path, "child.toml", 'extends = "base.toml"\n[task.2]\nforce_N = 4.0\n')
    source = read_source(child)
    assert source.values["task"][1] == {"kind": "tap", "force_N": 4.0}
    assert source.origins["task.1.force_N"] == "a thumb"


@pytest.mark.parametrize("key", ["task.3.force_N", "task.0.force_N", "task.first.force_N", "task.force_N", "task.-1.x"])
def test_a_table_that_the_array_does_not_have_is_refused_with_those_it_has(tmp_path: Path, key: str):
    source = read_source(write(tmp_path, "e.toml", TWO_TASKS))
    with pytest.raises(InputRefused, match=r"set on the command line: task\..*: there are tables task.1 to task.2"):
        apply_overrides(source, [f"{key}=5"])


def test_of_an_array_of_one_table_no_range_is_named(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", '[[task]]\nkind = "press"\n'))
    with pytest.raises(InputRefused, match=r"task\.2: there is only task\.1$"):
        apply_overrides(source, ["task.2.force_N=5"])


def test_single_numbers_of_three_are_set_by_their_number(root: Path):
    drawn = load_experiment(
        root / "experiments/fig4_force_position.toml",
        ["plant.joint_zero_deg.2=0.5", "plant.joint_zero_deg.3=-0.5", "robot.motor_zero_deg.1=0.25"],
    )
    assert drawn.values["plant"]["joint_zero_deg"] == (0.0, 0.5, -0.5)
    # the belief is the robot's and does not follow the plant
    assert drawn.values["controller"]["model"]["joint_zero_deg"] == (0.0, 0.0, 0.0)
    assert drawn.values["plant"]["motor_zero_deg"] == (0.25, 0.0, 0.0)


def test_a_single_number_of_three_that_no_file_states_stands_beside_zeros(root: Path):
    told = ["plant.joint_eccentricity_deg.2=0.3", "plant.head_mm.3=-20"]
    plant = load_experiment(root / "experiments/fig4_position.toml", told).plant
    assert plant.joint_eccentricity == (0.0, pytest.approx(radians(0.3)), 0.0)
    assert plant.head == (0.0, 0.0, pytest.approx(-0.02))


@pytest.mark.parametrize("key", ["plant.joint_zero_deg.4", "robot.joint_zero_deg.0", "plant.joint_zero_deg.first"])
def test_a_number_that_is_not_there_is_refused(root: Path, key: str):
    with pytest.raises(InputRefused, match=r"there are numbers .*joint_zero_deg\.1 to \.3"):
        load_experiment(root / "experiments/fig4_force_position.toml", [f"{key}=0.5"])


@pytest.mark.parametrize("name", ["motor.R", '"motor.R"', "'motor.R'"])
def test_a_parameter_whose_name_has_dots_is_set_with_quotes_and_without(tmp_path: Path, name: str):
    source = read_source(write(tmp_path, "e.toml", '[drive.parameters]\n"motor.R" = 1.0\nmotor.L = 2.0\n'))
    assert source.values["drive"]["parameters"] == {"motor.R": 1.0, "motor.L": 2.0}
    apply_overrides(source, [f"drive.parameters.{name}=3"])
    assert source.values["drive"]["parameters"] == {"motor.R": 3, "motor.L": 2.0}
    assert source.origins["drive.parameters.motor.R"] == "set on the command line"


def test_a_file_that_changes_a_part_keeps_the_drive_of_the_one_it_extends(tmp_path: Path):
    write(tmp_path, "base.toml", '[drive]\nfmu = "motor.toml"\n')
    child = 'extends = "base.toml"\n[drive.parts.machine.parameters]\nmotor.R = { value = 2.0, source = "measured" }\n'
    source = read_source(write(tmp_path, "child.toml", child))
    assert source.values["drive"] == {"fmu": "motor.toml", "parts": {"machine": {"parameters": {"motor.R": 2.0}}}}
    assert source.origins["drive.parts.machine.parameters.motor.R"] == "measured"
