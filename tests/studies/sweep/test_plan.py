"""A plan is checked before anything runs, and its keys say what a run computes.

Mistakes in a sweep file are told at once, each in one sentence that says what to do.
"""

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.studies.sweep.definitions import GAIN, SHORT, STIFFNESS, definition, stiffness_text, stiffnesses, written
from twin.kernel.errors import InputRefused
from twin.studies.sweep.plan import (
    MAX_PLANNED_RUNS,
    Condition,
    DesignPoint,
    SweepPlan,
    Value,
    Vary,
    largest_count,
    points,
    read_definition,
    read_plan,
    saltelli_cube,
    short_definition,
    unit_cube,
    why_not_saltelli,
)

numbers = st.lists(st.integers(-50, 50), min_size=1, max_size=4, unique=True)
grids = st.lists(numbers, min_size=1, max_size=4)
shares = st.floats(1e-12, 1.0 - 1e-12)


def vary(**table) -> Vary:
    return Vary.model_validate({"key": "k", **table})


def levels(key: str, values: list[int]) -> dict:
    return {"key": key, "values": values}


def identity(point: DesignPoint) -> tuple[object, ...]:
    return point.drive, *sorted(point.parameters.items())


@given(grids, st.sampled_from([[], ["a"], ["a", "b"]]))
def test_a_grid_is_every_combination_once_for_every_drive(values: list[list[int]], drives: list[str]):
    plan = definition(vary=[levels(f"k{n}", list_) for n, list_ in enumerate(values)], drives=drives)
    found = [identity(point) for point in points(plan)]
    assert len(set(found)) == len(found) == largest_count(plan)
    assert len(found) == math.prod(map(len, values)) * max(1, len(drives))


@given(st.sampled_from(["latin_hypercube", "random", "sobol"]), st.integers(0, 2**40), st.integers(0, 4))
def test_the_same_seed_draws_the_same_runs_for_every_drive(design: str, seed: int, exponent: int):
    tables = [{"key": "a", "from": -1.0, "to": 2.0}, {"key": "b", "distribution": "normal", "mean": 3.0, "std": 0.5}]
    plan = definition(design=design, seed=seed, runs=2**exponent, vary=tables, drives=["x", "y"])
    found = points(plan)
    assert found == points(plan)
    x, y = ([p.parameters for p in found if p.drive == drive] for drive in ("x", "y"))
    assert x == y and len(x) == 2**exponent
    assert all(-1.0 < float(parameters["a"]) < 2.0 for parameters in x)


def test_another_seed_draws_other_runs():
    tables = [{"key": "a", "from": 0.0, "to": 1.0}]
    one, other = (definition(design="random", seed=seed, runs=3, vary=tables) for seed in (1, 2))
    assert points(one) != points(other)


@given(st.integers(1, 40), st.integers(0, 100))
def test_a_latin_hypercube_has_one_draw_in_every_stratum_of_every_parameter(runs: int, seed: int):
    tables = [{"key": key, "from": 0.0, "to": 1.0} for key in "ab"]
    cube = unit_cube(definition(design="latin_hypercube", runs=runs, seed=seed, vary=tables))
    assert np.array_equal(np.sort(np.floor(cube * runs), axis=0), np.tile(np.arange(runs)[:, None], 2))


@given(st.integers(1, 7), st.integers(0, 100))
def test_a_sobol_sequence_has_one_draw_in_every_stratum_of_a_power_of_two(exponent: int, seed: int):
    runs = 2**exponent
    tables = [{"key": key, "from": 0.0, "to": 1.0} for key in "abc"]
    cube = unit_cube(definition(design="sobol", runs=runs, seed=seed, vary=tables))
    assert np.array_equal(np.sort(np.floor(cube * runs), axis=0), np.tile(np.arange(runs)[:, None], 3))


@given(shares)
def test_a_draw_is_the_quantile_of_its_distribution(u: float):
    low_high = {"from": 1.0, "to": 5.0}
    quantiles = [
        (vary(distribution="normal", mean=2.0, std=0.3), stats.norm(2.0, 0.3)),
        (vary(distribution="lognormal", median=1500.0, sigma=0.4), stats.lognorm(0.4, scale=1500.0)),
        (vary(distribution="uniform", **low_high), stats.uniform(1.0, 4.0)),
        (vary(scale="log", **low_high), stats.loguniform(1.0, 5.0)),
    ]
    for table, distribution in quantiles:
        # two libraries' inverses of the normal distribution differ in the last digits
        assert table.quantile(u) == pytest.approx(float(distribution.ppf(u)), rel=1e-9)


@given(numbers, shares)
def test_a_list_is_drawn_from_evenly(values: list[int], u: float):
    assert vary(values=values).quantile(u) == values[int(u * len(values))]


@given(st.floats(0.1, 10.0), st.floats(1.1, 100.0), st.integers(2, 9))
def test_levels_reach_both_ends_and_are_even_in_value_or_in_ratio(low: float, ratio: float, count: int):
    ends = {"from": low, "to": low * ratio, "count": count}
    even, log = (np.array(vary(scale=scale, **ends).levels(), dtype=float) for scale in ("linear", "log"))
    # rounding of numpy's spacing
    for found in (even, log):
        assert found[[0, -1]] == pytest.approx([low, low * ratio], rel=1e-12)
    assert np.diff(even) == pytest.approx(np.full(count - 1, low * (ratio - 1.0) / (count - 1)), rel=1e-6)
    assert log[1:] / log[:-1] == pytest.approx(np.full(count - 1, ratio ** (1.0 / (count - 1))), rel=1e-9)


@given(numbers, numbers, st.data())
def test_a_conditional_key_varies_only_where_its_condition_holds(first: list[int], second: list[int], data):
    wanted: Value = data.draw(st.sampled_from(first))
    tables = [levels("a", first), levels("b", second) | {"when": {"key": "a", "value": wanted}}]
    found = points(definition(vary=tables))
    assert all(("b" in point.parameters) == (point.parameters["a"] == wanted) for point in found)
    assert len(found) == len(first) - 1 + len(second) == len({identity(point) for point in found})


def test_a_condition_may_name_the_drive():
    tables = [levels("gain", [1, 2]) | {"when": {"key": "drive", "value": "b"}}]
    found = points(definition(vary=tables, drives=["a", "b"]))
    assert [(p.drive, p.parameters) for p in found] == [("a", {}), ("b", {"gain": 1}), ("b", {"gain": 2})]


def test_draws_that_are_alike_once_conditions_left_keys_out_are_one_run():
    tables = [levels("a", [1, 2]), {"key": "b", "from": 0.0, "to": 1.0, "when": {"key": "a", "value": 1}}]
    found = points(definition(design="random", runs=64, vary=tables))
    assert sum(point.parameters == {"a": 2} for point in found) == 1


def test_more_runs_than_fit_are_refused_before_any_is_made():
    tables = [{"key": key, "from": 0.0, "to": 1.0, "count": 1000} for key in "abc"]
    with pytest.raises(InputRefused, match=f"1,000,000,000 runs: more than {MAX_PLANNED_RUNS:,}"):
        points(definition(vary=tables))


TWO = [{"key": "a", "from": 0.0, "to": 1.0}, {"key": "b", "from": 1.0, "to": 2.0}]


def test_each_run_of_a_block_has_one_parameter_of_the_second_point_and_the_rest_of_the_first():
    blocks = saltelli_cube(8, 3, np.random.default_rng(0)).reshape(8, 5, 3)
    A, B = blocks[:, 0], blocks[:, 1]
    for i in range(3):
        expected = A.copy()
        expected[:, i] = B[:, i]
        assert np.array_equal(blocks[:, 2 + i], expected)
    assert not np.any(A == B)


def test_both_halves_fill_every_eighth_of_every_parameter_once():
    blocks = saltelli_cube(8, 3, np.random.default_rng(5)).reshape(8, 5, 3)
    for half in (blocks[:, 0], blocks[:, 1]):
        assert np.array_equal(np.sort((8 * half).astype(int), axis=0), np.tile(np.arange(8)[:, None], 3))


def test_runs_are_blocks_and_each_drive_runs_all_of_them():
    sweep = definition(design="saltelli", runs=4, vary=TWO, drives=["one", "other"])
    assert largest_count(sweep) == len(points(sweep)) == 2 * 4 * (2 + 2)
    one, other = points(sweep)[:16], points(sweep)[16:]
    assert [point.parameters for point in one] == [point.parameters for point in other]


def test_the_same_seed_makes_the_same_design_and_another_seed_another():
    runs = [points(definition(design="saltelli", runs=4, vary=TWO, seed=seed)) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize("key", ["values", "when"])
def test_what_makes_parameters_dependent_or_alike_is_named(key: str):
    table = Vary.model_validate({"key": "a", "from": 0.0, "to": 1.0})
    given = {"values": [1.0, 2.0], "when": Condition(key="b", value=1)}[key]
    (sentence,) = why_not_saltelli([table.model_copy(update={key: given})])
    assert sentence.startswith(f"[[vary]] 1: {key} does not go with")


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
    (task,) = read_plan(written(tmp_path, text)).tasks
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
        return read_plan(written(tmp_path, text)).tasks[0].key

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
        return read_plan(written(tmp_path, head + text)).configuration

    before, same = configuration(SAMPLED), configuration(SAMPLED + "# a comment\n")
    after = configuration(SAMPLED.replace(line, other))
    assert before == same
    assert before["the sweep"] != after["the sweep"]


def refused(root: Path, folder: Path, text: str) -> str:
    with pytest.raises(InputRefused) as refusal:
        read_plan(written(folder, f'experiment = "{root}/experiments/fig4_force_position.toml"\n{text}'))
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
        ('[[vary]]\nkey = "a"\nvalues = [1]\nwhen = { key = "b", value = 1 }\n', "no table precedes this one"),
    ],
)
def test_what_cannot_run_is_refused_before_the_first_run(root: Path, tmp_path: Path, text: str, told: str):
    assert told in refused(root, tmp_path, text)


def test_a_bad_end_of_a_range_is_found_among_many_runs(root: Path, tmp_path: Path):
    table = f'[[vary]]\nkey = "{STIFFNESS}"\nfrom = -100\nto = 10000\ncount = 1000\n'
    assert f"{STIFFNESS}=-100" in refused(root, tmp_path, table)


def test_measures_of_the_experiment_are_metrics_that_a_limit_may_name(root: Path, tmp_path: Path):
    def plan(metric: str) -> SweepPlan:
        text = f'[limits]\n"{metric}" = 0.1\n[[vary]]\nkey = "duration_s"\nvalues = [2]\n'
        return read_plan(written(tmp_path, f'experiment = "{root}/experiments/step_z_air.toml"\n{text}'))

    assert "z.rise_time" in plan("z.rise_time").metrics
    with pytest.raises(InputRefused, match=r"z\.rise_tim: no such metric; did you mean 'z\.rise_time'\?"):
        plan("z.rise_tim")


def test_a_part_of_another_make_is_in_the_key_and_pinned_for_every_run(root: Path, tmp_path: Path):
    def only(content: str) -> tuple[str, tuple[str, ...]]:
        (tmp_path / "mine.py").write_text(content)
        text = f'experiment = "e.toml"\n[[vary]]\nkey = "{STIFFNESS}"\nvalues = [700]\n'
        (task,) = read_plan(written(tmp_path, text)).tasks
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


VARY = '[[vary]]\nkey = "contact.stiffness_N_per_m"\n'
LEVELS = f"{VARY}from = 500\nto = 5000\ncount = 3\n"
DRAWN = 'design = "latin_hypercube"\nruns = 4\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LEVELS.replace("count", "cuont"), "[[vary]] unknown key 'cuont'; did you mean 'count'?"),
        (f"sed = 3\n{LEVELS}", "unknown key 'sed'; did you mean 'seed'?"),
        ("", "varies nothing; add a table [[vary]], or drives"),
        (f"{VARY}values = []\n", "values"),
        (LEVELS.replace("count = 3", "count = 0"), "count"),
        (f"{VARY}from = 5\nto = 1\ncount = 2\n", "from = 5, to = 1: expected from < to"),
        (f'{VARY}from = 0\nto = 1\ncount = 2\nscale = "log"\n', 'scale = "log" needs a number > 0'),
        (f"{VARY}values = [1, 2, 1]\n", "values: one is there twice"),
        (f"{VARY}from = 1\nto = 2\n", "missing key 'count'"),
        (f"{LEVELS}{LEVELS}", "'contact.stiffness_N_per_m' varies already in another table"),
        (f'drives = ["a", "a"]\n{LEVELS}', "drives: 'a' is named twice"),
        (f"runs = 3\n{LEVELS}", "runs: a grid has as many runs as its levels make"),
        (f'design = "sobol"\nruns = 12\n{VARY}from = 1\nto = 2\n', "choose 8 or 16"),
        (f'design = "random"\n{VARY}from = 1\nto = 2\n', "missing key 'runs'"),
        (f'{DRAWN}{VARY}distribution = "normal"\nmean = 1\n', "missing key 'std'"),
        (f'{DRAWN}{VARY}distribution = "normal"\nmean = 1\nstd = 0\n', "std"),
        (f'{VARY}distribution = "normal"\nmean = 1\nstd = 1\n', "distribution: a grid has levels"),
        (f"{DRAWN}{LEVELS}", "count: belongs to a grid"),
        ('[[vary]]\nkey = "a"\nkeys = ["b"]\nvalues = [1]\n', "expected either key or keys"),
        (f'{LEVELS}when = {{ key = "no", value = 1 }}\n', "when: 'no' is not decided before"),
        ('[[vary]]\nkey = "drive"\nvalues = ["a"]\n', "name drives = [...] at the top"),
        ("runs = ", "not valid TOML"),
        (LEVELS.replace("500\n", "nan\n"), "from"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(tmp_path: Path, text: str, told: str):
    path = written(tmp_path, f'experiment = "e.toml"\n{text}')
    with pytest.raises(InputRefused) as refusal:
        read_definition(path)
    assert told in str(refusal.value)
    assert all(line.startswith(f"{path}: ") for line in str(refusal.value).splitlines())


def test_several_mistakes_are_told_at_once(tmp_path: Path):
    path = written(tmp_path, 'experiment = "e.toml"\ndrives = ["a", "a"]\nruns = 3\n' + LEVELS + LEVELS)
    with pytest.raises(InputRefused) as refusal:
        read_definition(path)
    assert len(str(refusal.value).splitlines()) == 3


def test_a_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(InputRefused, match="no such sweep file"):
        read_definition(tmp_path / "no.toml")


def test_the_short_form_is_the_grid_that_a_file_would_say():
    found = short_definition(Path("e.toml"), ["a.b=1:3:3", "c=0.5:1:2"], "pmsm_foc")
    assert [vary.levels() for vary in found.vary] == [(1.0, 2.0, 3.0), (0.5, 1.0)]
    assert [vary.label for vary in found.vary] == ["a.b", "c"]
    assert found.drives == ["pmsm_foc"] and found.design == "grid"


@pytest.mark.parametrize(
    "text",
    [
        "a",
        "a=1",
        "a=1:2",
        "a=1:2:3:4",
        "a=x:2:3",
        "a=2:1:3",
        "a=1:2:0",
        "a=1:2:1.5",
        "=1:2:2",
        "a=1:2_0:2",
        "a=1:2:1_0",
    ],
)
def test_a_range_that_is_none_is_refused(text: str):
    with pytest.raises(InputRefused, match="--sweep"):
        short_definition(Path("e.toml"), [text], None)
