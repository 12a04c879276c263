"""A robot of one's own: the file that lengths give, and the experiments that run on it."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin
from twin.kernel.errors import InputRefused
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import checked_experiment, load_experiment
from twin.robot.assembly.own_robot import experiment_on_robot, start_on_robot, start_robot
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import known_experiments
from twin.robot.experiment.mistakes import toml_keys
from twin.robot.experiment.source import Source, is_robot, read_source
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.run.trace import run_in_memory
from twin.studies.workspace.capability import capability

SHIPPED = ("a=50", "b=30", "l_a=60", "l_b=113.9")
SIZES = {
    "smaller": ("a=30", "b=18", "l_a=36", "l_b=68.34"),
    "larger": ("a=70", "b=42", "l_a=84", "l_b=159.46"),
    "lower": ("a=50", "b=30", "l_a=60", "l_b=145.9"),
    "slender": ("a=40", "b=40", "l_a=90", "l_b=110"),
    "other": ("a=80", "b=35", "l_a=100", "l_b=180"),
}


@pytest.fixture(params=SIZES)
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The file of a robot of another size or shape."""
    path = tmp_path / f"{request.param}.toml"
    start_robot(path, SIZES[request.param])
    return path


def test_the_lengths_of_the_shipped_robot_give_the_heights_of_the_shipped_experiments(tmp_path: Path):
    path = tmp_path / "same.toml"
    start_robot(path, SHIPPED)
    found = read_source(path).values
    massage = load_experiment("massage")
    assert found["contact"] == {"height_mm": 1e3 * massage.contact.height}
    approach = massage.values["approach"]
    assert found["approach"] == approach
    assert massage.monitor is not None
    ends = {key: round(1e3 * getattr(massage.monitor, key), 6) for key in ("z_min", "z_max", "workspace_radius")}
    assert found["monitor"] == {f"{key}_mm": value for key, value in ends.items()}
    own = experiment_on_robot(path, "fig4_force_position")
    assert own.reference == load_experiment("fig4_force_position").reference


def test_in_the_home_pose_all_links_are_20_deg_down_and_the_surface_is_4_mm_above(robot: Path, tmp_path: Path):
    experiment = experiment_on_robot(robot, "fig4_force_position")
    (text,) = re.findall(r"home pose: p = \(0, 0, (-[\d.]+)\) mm", robot.read_text())
    home = 1e-3 * float(text)
    theta_l = joint_angles(geometry_of(experiment.plant), (0.0, 0.0, home))
    # the file has the height to 0.1 mm
    assert np.degrees(theta_l) == pytest.approx(20.0, abs=0.1)
    assert experiment.contact.height == pytest.approx(home + 4e-3, abs=0.6e-3)


@pytest.mark.parametrize("name", ["fig4_force_position", "pressing"])
def test_a_robot_of_another_size_presses_without_more_edits(robot: Path, tmp_path: Path, name: str):
    file = tmp_path / "press.toml"
    start_on_robot(file, name, robot)
    experiment = load_experiment(file)
    F_ref = {"fig4_force_position": 5.0, "pressing": 8.0}[name]
    run = run_in_memory(experiment, experiment.controller_ticks, ("plant.F_ee_B", "controller.F_z_ref", "plant.p_B"))
    F_z, reference = -run["plant.F_ee_B"][:, 2], run["controller.F_z_ref"]
    t = np.arange(len(F_z)) * experiment.controller_ticks * experiment.cosim.tick
    held = (t > 9.0) & (t < 18.0) if name == "fig4_force_position" else (reference > 7.999) & (t > 6.0) & (t < 9.0)
    assert held.sum() > 1000
    # Fig. 4 presses 0.1 N off on the shipped robot, the tasks 0.01 N
    assert np.sqrt(np.mean((F_z[held] - F_ref) ** 2)) < {5.0: 0.25, 8.0: 0.05}[F_ref]
    assert run["plant.p_B"][held, 2] == pytest.approx(experiment.contact.height - F_ref / 1250.0, abs=0.3e-3)


def test_every_shipped_experiment_moves_with_the_surface_of_every_robot(robot: Path, tmp_path: Path):
    rise = 1e-3 * read_source(robot).values["contact"]["height_mm"] + 0.101
    for name in known_experiments():
        own, shipped = experiment_on_robot(robot, name), load_experiment(name)
        assert own.controller == shipped.controller.model_copy(update={"model": own.controller.model})
        assert (own.monitor is None) == (shipped.monitor is None)
        assert own.contact.height == pytest.approx(shipped.contact.height + rise)
        if own.reference is not None and shipped.reference is not None and own.reference.shape != "joint_step":
            pairs = zip(own.reference.p, shipped.reference.p, strict=True)
            pressing = [(moved[2], before[2] + rise) for moved, before in pairs if before[2] < -0.101]
            assert all(moved == pytest.approx(expected) for moved, expected in pressing)


def test_the_file_has_every_key_of_the_robot_and_says_where_values_come_from(robot: Path):
    text, source = robot.read_text(), read_source(robot)
    assert is_robot(source.values)
    for table in ("robot", "approach", "monitor"):
        part = text[text.index(f"\n[{table}]") :].partition("\n[")[2].partition("\n[")[0]
        assert set(toml_keys(DECLARED_TABLES.tables[table])) == set(re.findall(r"(?m)^#?(\w+) = ", part))
    # active and inherited values have a source
    assert all(source.origins[f"robot.{name}_mm"] == "given: --lengths-mm" for name in ("a", "b", "l_a", "l_b"))
    assert '#k_s_Nm_per_rad = { value = 1.0, source = "Sec. III.A' in text
    for key in ("contact.height_mm", "approach.height_mm", "approach.floor_mm", "monitor.z_min_mm", "monitor.z_max_mm"):
        assert source.origins[key].startswith("computed: "), key
    for remark in ("home pose: p =", "range of the joint encoders", "range of the motor encoders", "p_mm = [["):
        assert f"# {remark}" in text


def test_the_ranges_of_the_encoders_are_those_of_a_cylinder_full_of_poses(robot: Path):
    experiment = experiment_on_robot(robot, "pressing")
    plant, limits, text = experiment.plant, experiment.monitor, robot.read_text()
    assert limits is not None
    r, turn, z = np.meshgrid(
        np.linspace(0.0, limits.workspace_radius, 35),
        np.radians(np.arange(360.0)),
        np.linspace(limits.z_min, limits.z_max, 27),
    )
    theta_l = joint_angles(geometry_of(plant), np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=-1))
    bent = limits.deflection_limit
    for name, counts, low, high in (
        ("joint", plant.joint_counts_per_turn, theta_l.min(), theta_l.max()),
        ("motor", plant.motor_counts_per_turn, plant.N * theta_l.min() - bent, plant.N * theta_l.max() + bent),
    ):
        found = re.search(
            rf"{name} encoders within \[monitor\]: (\S+) to (\S+) deg, counts (\S+) to (\S+) of (\d+)", text
        )
        assert found is not None
        # written to 0.1 deg
        assert [float(found[1]), float(found[2])] == pytest.approx(np.degrees([low, high]), abs=0.1)
        turn = 360.0 / counts
        assert [int(found[3]) * turn, int(found[4]) * turn] == pytest.approx(
            [float(found[1]), float(found[2])], abs=0.1
        )
        assert int(found[5]) == counts


def test_an_experiment_on_a_robot_is_built_once(robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    built: list[str] = []

    def build(source: Source, name: str, *places: Path) -> Experiment:
        built.append(name)
        return checked_experiment(source, name, *places)

    monkeypatch.setattr("twin.robot.assembly.own_robot.checked_experiment", build)
    assert twin("init", "press.toml", "--robot", robot, cwd=tmp_path).returncode == 0
    assert built == [robot.stem]


@pytest.mark.parametrize("name", ["m_a", "m_b", "m_p"])
def test_a_robots_file_without_a_mass_is_refused_by_name(tmp_path: Path, name: str):
    path = tmp_path / "mine.toml"
    start_robot(path, SIZES["other"], ["m_a=50", "m_b=30", "m_p=120"])
    path.write_text(re.sub(rf"(?m)^{name}_g = .*$", f"{name}_g = 0", path.read_text()))
    for words in (["init", "press.toml", "--robot", path], ["robot", path, "--no-rank"]):
        done = twin(*words, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (2, f"{path}: [robot] {name}_g = 0: expected a mass > 0 g\n")
    assert not (tmp_path / "press.toml").exists()


def test_masses_and_other_values_are_the_robots_own(tmp_path: Path):
    path = tmp_path / "heavy.toml"
    start_robot(path, SIZES["other"], ["m_p=150", "m_a=60"], ["robot.k_s_Nm_per_rad=2"])
    experiment = experiment_on_robot(path, "fig4_force_position")
    assert (experiment.plant.m_p, experiment.plant.m_a, experiment.plant.m_b) == pytest.approx((0.150, 0.060, 0.030))
    assert experiment.plant.k_s == experiment.controller.model.k_s == 2.0
    assert experiment.origins["robot.m_p_g"] == "given: --masses-g"
    assert experiment.origins["robot.m_b_g"].startswith("assumed")


def test_a_height_changed_in_the_robots_file_moves_its_experiments(tmp_path: Path):
    path = tmp_path / "mine.toml"
    start_robot(path, SIZES["other"])
    path.write_text(re.sub(r"(?m)^height_mm = \{ value = -145.0.*$", "height_mm = -150.0", path.read_text()))
    experiment = experiment_on_robot(path, "fig4_force_position")
    assert experiment.contact.height == pytest.approx(-0.150) and experiment.reference is not None
    assert min(z for _, _, z in experiment.reference.p) == pytest.approx(-0.154)


def test_limits_that_encoders_or_springs_cannot_keep_are_raised_and_say_so(tmp_path: Path):
    small, large = tmp_path / "small.toml", tmp_path / "large.toml"
    start_robot(small, SIZES["smaller"])
    start_robot(large, ["a=100", "b=60", "l_a=120", "l_b=227.8"])
    assert read_source(small).values["monitor"]["contact_force_N"] > 1.0
    assert read_source(small).origins["monitor.contact_force_N"] == "computed: encoders and springs allow no less"
    assert read_source(large).values["monitor"]["deflection_limit_deg"] > 20.0
    assert "force_limit_N" not in read_source(small).values["monitor"]


@pytest.mark.parametrize(
    ("lengths", "masses", "told"),
    [
        (("a=nan", "b=35", "l_a=100", "l_b=180"), (), "--lengths-mm a=nan: expected a number of mm from 1 to 5000"),
        (("a=80", "b=-35", "l_a=100", "l_b=180"), (), "--lengths-mm b=-35: expected"),
        (("a=80", "b=35", "l_a=0", "l_b=180"), (), "--lengths-mm l_a=0: expected"),
        (("a=80", "b=35", "l_a=100", "l_b=inf"), (), "--lengths-mm l_b=inf: expected"),
        (("a=0.08", "b=0.035", "l_a=0.1", "l_b=0.18"), (), "--lengths-mm a=0.08: expected"),
        (("a=80", "b=35", "l_a=100", "l_b=wide"), (), "--lengths-mm l_b=wide: expected"),
        (("a=80", "b=35", "l_a=100", "l_c=180"), (), "--lengths-mm l_c=180: unknown or given twice"),
        (("a=80", "a=80", "b=35", "l_a=100"), (), "--lengths-mm a=80: unknown or given twice"),
        (("a=80", "b=35", "l_a=100"), (), "--lengths-mm: l_b is missing"),
        (("a=80", "b=35", "l_a=100", "l_b=120"), (), "no home pose: the legs do not meet .* expected l_b > 139.0 mm"),
        (("a=8", "b=3.5", "l_a=10", "l_b=18"), (), "no home pose: .* mm inside each other"),
        (("a=20", "b=200", "l_a=60", "l_b=180"), (), "no room to work at the home pose"),
        (("a=800", "b=350", "l_a=1000", "l_b=1800"), (), "springs too soft: .* --set robot.k_s_Nm_per_rad="),
        (("a=80", "b=35", "l_a=30", "l_b=76"), (), "no room to work at the home pose"),
        (SIZES["other"], ("m_a=0",), "--masses-g m_a=0: expected a number of g from 0.001"),
        (SIZES["other"], ("m_p=-1",), "--masses-g m_p=-1: expected"),
        (SIZES["other"], ("m_b=nan",), "--masses-g m_b=nan: expected"),
        (SIZES["other"], ("m_c=30",), "--masses-g m_c=30: unknown or given twice"),
        (SIZES["other"], ("m_p=20000",), "springs too soft"),
    ],
)
def test_a_robot_that_cannot_be_is_one_sentence_and_no_file(tmp_path: Path, lengths, masses, told: str):
    path = tmp_path / "mine.toml"
    with pytest.raises(InputRefused, match=told) as refusal:
        start_robot(path, lengths, masses)
    assert "\n" not in str(refusal.value) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("monitor.force_limit_N=3", r"other values of \[robot\]"),
        ("robot.m_p_g=0", r"other values of \[robot\]"),
        ("robot.a_mm=70", r"other values of \[robot\]"),
        ("robot=3", r"other values of \[robot\]"),
        ("robot.k_s=3", "unknown key"),
    ],
)
def test_other_values_are_those_of_the_robot_and_right(tmp_path: Path, setting: str, told: str):
    with pytest.raises(InputRefused, match=told):
        start_robot(tmp_path / "mine.toml", SIZES["other"], (), [setting])


def test_an_existing_file_stays(robot: Path, tmp_path: Path):
    before = robot.read_text()
    with pytest.raises(InputRefused, match="exists, and is never overwritten"):
        start_robot(robot, SIZES["other"])
    assert robot.read_text() == before


def test_an_experiment_that_the_robot_cannot_do_is_not_written(robot: Path, tmp_path: Path):
    robot.write_text(re.sub(r"(?m)^floor_mm = .*$", "floor_mm = -900.0", robot.read_text()))
    file = tmp_path / "press.toml"
    with pytest.raises(InputRefused, match="out of reach"):
        start_on_robot(file, "pressing", robot)
    assert not file.exists()
    with pytest.raises(InputRefused, match="not a robot file"):
        start_on_robot(file, "pressing", known_experiments()["pressing"])
    with pytest.raises(InputRefused, match="no such robot file"):
        start_on_robot(file, "pressing", tmp_path / "nobody.toml")


@pytest.mark.parametrize("value", ['"high"', "nan", "true"])
def test_an_invalid_height_in_a_robots_file_is_refused_by_name(tmp_path: Path, value: str):
    path = tmp_path / "mine.toml"
    start_robot(path, SIZES["other"])
    path.write_text(re.sub(r"(?m)^height_mm = \{ value = -145.0", f"height_mm = {{ value = {value}", path.read_text()))
    with pytest.raises(InputRefused, match=r"mine.toml: \[contact\] height_mm = "):
        start_on_robot(tmp_path / "press.toml", "pressing", path)


@pytest.mark.parametrize("name", ["robot", "contact"])
def test_a_value_in_the_place_of_a_table_is_refused_by_name(tmp_path: Path, name: str):
    path = tmp_path / "mine.toml"
    path.write_text(f'extends = "robots/massage_robot.toml"\n{name} = 3\n')
    with pytest.raises(InputRefused, match=rf"mine.toml: \[{name}\] = 3: expected a table"):
        start_on_robot(tmp_path / "press.toml", "pressing", path)


def test_the_deflection_limit_leaves_room_for_a_heavy_robots_weight(tmp_path: Path):
    path = tmp_path / "heavy.toml"
    start_robot(path, ["a=84.2", "b=46.8", "l_a=152.5", "l_b=350.4"], ["m_a=356", "m_b=86.8", "m_p=457.6"])
    experiment = experiment_on_robot(path, "pressing")
    assert experiment.monitor is not None and experiment.monitor.deflection_limit > np.radians(20.0)
    bent = np.degrees(capability(experiment, rank=False).weight_deflection)
    # at rest on the axis; the monitor's middle is 4 mm deeper
    assert np.degrees(experiment.monitor.deflection_limit) > 1.2 * bent > 20.0
