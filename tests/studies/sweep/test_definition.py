"""Mistakes in a sweep file are told at once, each in one sentence that says what to do."""

from pathlib import Path

import pytest

from tests.studies.sweep.definitions import written
from twin.kernel.errors import InputRefused
from twin.studies.sweep.plan import read_definition, short_definition

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
    "text", ["a", "a=1", "a=1:2", "a=1:2:3:4", "a=x:2:3", "a=2:1:3", "a=1:2:0", "a=1:2:1.5", "=1:2:2"]
)
def test_a_range_that_is_none_is_refused(text: str):
    with pytest.raises(InputRefused, match="--sweep"):
        short_definition(Path("e.toml"), [text], None)
