from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment


@pytest.fixture
def fig4(root: Path) -> Path:
    return root / "experiments" / "fig4_force_position.toml"


def mistakes(path: Path, *overrides: str) -> str:
    with pytest.raises(InputRefused) as refusal:
        load_experiment(path, overrides)
    assert refusal.value.exit_code == 2
    return str(refusal.value)


def test_every_shipped_experiment_is_valid(root: Path):
    for path in sorted((root / "experiments").glob("*.toml")):
        assert isinstance(load_experiment(path), Experiment), path


def test_every_value_of_the_robot_states_its_source(fig4: Path):
    origins = load_experiment(fig4).origins
    unsourced = [key for key in origins if key.startswith("robot.") and origins[key].startswith("set in")]
    assert unsourced == ["robot.name"]


def test_values_are_si_inside(fig4: Path):
    experiment = load_experiment(fig4)
    assert experiment.contact.height == -0.101
    assert experiment.controller.force.kp == 0.002
    assert experiment.controller_ticks == 2
    assert experiment.duration_ticks == 20_000


def test_truth_and_belief_are_set_apart(fig4: Path):
    experiment = load_experiment(fig4, ["plant.k_s_Nm_per_rad=0.8", "controller.model.m_p_g=120"])
    assert (experiment.plant.k_s, experiment.controller.model.k_s) == (0.8, 1.0)
    assert (experiment.plant.m_p, experiment.controller.model.m_p) == (0.1, 0.12)


def test_the_robot_is_what_both_are_by_default(fig4: Path):
    experiment = load_experiment(fig4, ["robot.k_s_Nm_per_rad=0.9"])
    assert experiment.plant.k_s == experiment.controller.model.k_s == 0.9


def test_one_joint_may_have_another_drive(fig4: Path):
    experiment = load_experiment(fig4, ["drive.joint_2.fmu='fmus/pmsm_foc'", "drive.joint_3.parameters.droop=0.3"])
    assert [Path(drive.fmu or "").stem for drive in experiment.drives] == [
        "velocity_servo",
        "pmsm_foc",
        "velocity_servo",
    ]
    assert [drive.parameters for drive in experiment.drives] == [{"droop": 0.6}, {}, {"droop": 0.3}]


def test_all_mistakes_are_told_at_once(fig4: Path):
    told = mistakes(
        fig4,
        "controller.force.kp_N=3",
        "contact.stiffness_N_per_m=-50",
        "reference.p_mm=[[0, 20, -85], [0, 20, -85], [0, 20, -180], [0, 0, -105], [0, 0, -105], [0, 0, -105]]",
    )
    assert "has 3 mistakes" in told
    assert "[controller.force] unknown key 'kp_N'; did you mean 'kp_mm_per_N'?" in told
    assert "[contact] stiffness_N_per_m = -50: expected a number >= 0" in told
    assert "[reference] way point 3: p_B = (0.0, 20.0, -180.0) mm is out of reach: leg 1" in told


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("controller.force_N=4", "[controller] unknown key 'force_N'; did you mean 'force.reference_N'"),
        ("controller.force_m=4", "[controller] unknown key 'force_m'; did you mean 'force'?"),
        ("controller.model.k_s=1", "did you mean 'k_s_Nm_per_rad'?"),
        ("contact.height_m=-0.1", "unknown key 'height_m'; did you mean 'height_mm'?"),
        ("contact.height_mm='high'", 'height_mm = "high": expected a number'),
        ("controller.mode=force", "expected 'force_position' or 'position'"),
        ("controller.gravity_compensation=1", "expected true or false"),
        ("robot.k_s_Nm_per_rad=-1", "k_s_Nm_per_rad = -1: expected a number > 0"),
        ("robot.motor_counts_per_turn=1.5", "expected a whole number"),
        ("contact.stiffness_N_per_m=nan", "expected a finite number"),
        ("controller.period_ms=1.5", "[controller] period_ms: 0.0015 s is not a whole number of ticks"),
        ("duration_s=0", "duration_s = 0: expected a number > 0"),
        ("reference.t_s=[0, 1]", "2 times and 6 points"),
        ("reference.t_s=[0, 2, 1, 3, 4, 5]", "expected times that increase"),
        ("reference.p_mm=[[0, 20]]", "has too few values"),
        ("recording.rate='fast'", "[recording] rate = \"fast\": expected 'tick' or 'controller'"),
        ("sead=1", "unknown key 'sead'; did you mean 'seed'?"),
        ("controller=3", "[controller] "),
        ("drive.gear_ratio='much'", "expected a number"),
    ],
)
def test_a_mistake_is_one_clear_sentence(fig4: Path, override: str, said: str):
    assert said in mistakes(fig4, override)


def test_a_mistake_in_the_robot_is_told_once(fig4: Path):
    assert "mistakes" not in mistakes(fig4, "robot.k_s_Nm_per_rad=-1")


def test_a_missing_key_and_a_missing_table_are_named(tmp_path: Path):
    file = tmp_path / "e.toml"
    file.write_text('title = "x"\n[cosim]\ntick_ms = 1.0\n')
    told = mistakes(file)
    assert "missing key 'duration_s'" in told
    assert "[cosim] missing key 'scheme'" in told
    assert "missing table [robot]" in told


def test_a_line_that_leaves_the_workspace_between_reachable_points_is_refused(fig4: Path):
    told = mistakes(fig4, "reference.t_s=[0, 1]", "reference.p_mm=[[60, 0, -45], [-60, 0, -45]]")
    assert "[reference] between way points 1 and 2: p_B = " in told
