"""A plan is checked before anything runs, and its keys say what a run computes."""

import hashlib
from pathlib import Path

import pytest

from tests.studies.sweep.definitions import GAIN, SHORT, STIFFNESS, stiffness_text, stiffnesses, written
from twin.errors import InputRefused
from twin.studies.sweep.plan import Plan, planned

SPRING = '["plant.k_s_Nm_per_rad", "controller.model.k_s_Nm_per_rad"]'


def test_every_run_has_a_number_and_a_key_of_its_own(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500, 1000, 1500.5]", 'drives = ["pmsm_foc", "brushed_dc"]')
    assert [task.run for task in plan.tasks] == [1, 2, 3, 4, 5, 6]
    assert len({task.key for task in plan.tasks}) == 6


def test_one_drive_under_two_names_is_two_runs(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500]", f'drives = ["pmsm_foc", "{root}/fmus/pmsm_foc"]')
    assert len({task.key for task in plan.tasks}) == 2


def test_linked_keys_get_the_same_value(root: Path, tmp_path: Path):
    text = stiffness_text(root, "[500]").replace(SHORT, f"{{ keys = {SPRING}, values = [2.5] }}")
    (task,) = planned(written(tmp_path, text)).tasks
    assert "plant.k_s_Nm_per_rad=2.5" in task.settings and "controller.model.k_s_Nm_per_rad=2.5" in task.settings
    assert task.parameters == {STIFFNESS: 500, "plant.k_s_Nm_per_rad": 2.5}


def test_a_run_keeps_its_key_when_others_are_added_or_the_order_changes(root: Path, tmp_path: Path):
    one = {task.parameters[STIFFNESS]: task.key for task in stiffnesses(root, tmp_path, "[500, 1000]").tasks}
    other = {task.parameters[STIFFNESS]: task.key for task in stiffnesses(root, tmp_path, "[2000, 1000, 500]").tasks}
    assert one.items() <= other.items()


def test_keys_know_the_experiments_values_and_the_drives_binary(root: Path, tmp_path: Path):
    def key(base: str) -> str:
        written(tmp_path, f'extends = "{root}/experiments/fig4_force_position.toml"\n{base}', "e.toml")
        text = f'experiment = "e.toml"\n[[vary]]\nkey = "{STIFFNESS}"\nvalues = [700]\n'
        return planned(written(tmp_path, text)).tasks[0].key

    same = key("")
    assert key("# a comment\n") == same
    assert key("duration_s = 19\n") != same
    assert key(f'[drive]\nfmu = "{root}/fmus/pmsm_foc"\n') != same
    assert key("[controller.force]\nkp_mm_per_N = 1.75\n") != same


SAMPLED = """design = "random"
runs = 3
seed = 7
drives = ["velocity_servo"]
[limits]
peak_N = 9
[[vary]]
key = "contact.stiffness_N_per_m"
from = 500
to = 900
"""


@pytest.mark.parametrize(
    ("line", "other"),
    [
        ('design = "random"', 'design = "latin_hypercube"'),
        ("runs = 3", "runs = 4"),
        ("seed = 7", "seed = 8"),
        ('drives = ["velocity_servo"]', 'drives = ["ideal_velocity"]'),
        ("peak_N = 9", "peak_N = 8"),
        ("to = 900", "to = 800"),
    ],
)
def test_a_sweep_with_another_line_is_another_configuration(root: Path, tmp_path: Path, line: str, other: str):
    """Rows of two seeds in one folder would be one design's no more."""
    head = f'experiment = "{root}/experiments/fig4_force_position.toml"\n'

    def configuration(text: str) -> dict[str, str]:
        return planned(written(tmp_path, head + text)).configuration

    before, same = configuration(SAMPLED), configuration(SAMPLED + "# a comment\n")
    after = configuration(SAMPLED.replace(line, other))
    assert before == same
    assert before["the sweep"] != after["the sweep"]


def refused(root: Path, folder: Path, text: str) -> str:
    with pytest.raises(InputRefused) as refusal:
        planned(written(folder, f'experiment = "{root}/experiments/fig4_force_position.toml"\n{text}'))
    return str(refusal.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[[vary]]\nkey = "contact.stifness_N_per_m"\nvalues = [500]\n', "did you mean 'stiffness_N_per_m'?"),
        ('[[vary]]\nkey = "contact.stiffness_N_per_m"\nvalues = [500, 700, -1]\n', "stiffness_N_per_m=-1"),
        (f'[[vary]]\nkey = "{GAIN}"\nvalues = ["much"]\n', 'kp_mm_per_N="much"'),
        ('drives = ["no_such_drive"]\n', "the run with drive no_such_drive cannot be made"),
        (
            f'[limits]\npek_N = 7\n[[vary]]\nkey = "{GAIN}"\nvalues = [1]\n',
            "[limits] pek_N: no such metric; did you mean",
        ),
        ('[[vary]]\nkey = "a"\nvalues = [1]\nwhen = { key = "b", value = 1 }\n', "no table stands before this one"),
    ],
)
def test_what_cannot_run_is_refused_before_the_first_run(root: Path, tmp_path: Path, text: str, told: str):
    assert told in refused(root, tmp_path, text)


def test_a_bad_end_of_a_range_is_found_among_many_runs(root: Path, tmp_path: Path):
    table = f'[[vary]]\nkey = "{STIFFNESS}"\nfrom = -100\nto = 10000\ncount = 1000\n'
    assert f"{STIFFNESS}=-100" in refused(root, tmp_path, table)


def test_measures_of_the_experiment_are_metrics_that_a_limit_may_name(root: Path, tmp_path: Path):
    def plan(metric: str) -> Plan:
        text = f'[limits]\n"{metric}" = 0.1\n[[vary]]\nkey = "duration_s"\nvalues = [2]\n'
        return planned(written(tmp_path, f'experiment = "{root}/experiments/step_z_air.toml"\n{text}'))

    assert "z.rise_time" in plan("z.rise_time").metrics
    with pytest.raises(InputRefused, match=r"z\.rise_tim: no such metric; did you mean 'z\.rise_time'\?"):
        plan("z.rise_tim")


def test_a_part_of_another_make_is_in_the_key_and_pinned_for_every_run(root: Path, tmp_path: Path):
    def only(content: str) -> tuple[str, tuple[str, ...]]:
        (tmp_path / "mine.py").write_text(content)
        text = f'experiment = "e.toml"\n[[vary]]\nkey = "{STIFFNESS}"\nvalues = [700]\n'
        (task,) = planned(written(tmp_path, text)).tasks
        return task.key, task.settings

    base = f'extends = "{root}/experiments/fig4_force_position.toml"\n[controller]\npython = "mine.py:Controller"\n'
    written(tmp_path, base, "e.toml")
    # nothing of it is run here: a plan is made by the process that everything depends on
    (one, settings), (other, _) = only("raise SystemExit"), only("raise SystemExit(1)")
    assert one != other
    digest = hashlib.sha256(b"raise SystemExit").hexdigest()
    assert settings == (f"{STIFFNESS}=700", f'controller.sha256="{digest}"')
    with pytest.raises(InputRefused, match=r"mine\.py, line 1: "):
        only("def f(")
