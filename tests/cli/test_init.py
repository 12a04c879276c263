import json
from pathlib import Path

from tests.command_line import twin


def test_what_init_writes_in_an_empty_folder_runs_as_it_is(tmp_path: Path):
    done = twin("init", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "experiment.toml\nexperiment.schema.json\nnext: twin run experiment.toml\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["experiment.schema.json", "experiment.toml"]
    assert (tmp_path / "experiment.toml").read_text().startswith("#:schema experiment.schema.json\n")
    ran = twin("run", "experiment.toml", "--drive", "pmsm_foc", "--set", "duration_s=1", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr


def test_init_overwrites_neither_experiment_nor_schema(tmp_path: Path):
    schema, mine = tmp_path / "experiment.schema.json", tmp_path / "mine.toml"
    schema.write_text("{}")
    assert twin("init", mine, "--from", "tapping", cwd=tmp_path).stdout == f"{mine}\nnext: twin run {mine}\n"
    before = mine.read_text()
    again = twin("init", mine, cwd=tmp_path)
    assert again.returncode == 2
    assert again.stderr == f"{mine}: exists, and is never overwritten; choose another name\n"
    assert (mine.read_text(), schema.read_text()) == (before, "{}")


def test_the_schema_is_printed_or_written(tmp_path: Path):
    printed = twin("schema", cwd=tmp_path)
    assert json.loads(printed.stdout)["type"] == "object"
    assert twin("schema", "--out", "s.json", cwd=tmp_path).stdout == "s.json\n"
    assert (tmp_path / "s.json").read_text() == printed.stdout


def test_a_schema_that_cannot_be_written_is_one_sentence(tmp_path: Path):
    (tmp_path / "file").touch()
    refused = twin("schema", "--out", "file/s.json", cwd=tmp_path)
    assert refused.returncode == 3
    assert refused.stderr == "file/s.json: cannot be written: Not a directory\n"


LENGTHS = ("--lengths-mm", "a=80", "b=35", "l_a=100", "l_b=180")


def test_a_new_robot_presses_without_more_edits(tmp_path: Path):
    done = twin("init", "--robot", "mine.toml", *LENGTHS, "--masses-g", "m_a=50", "m_p=120", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "mine.toml",
        "experiment.schema.json",
        "next: twin robot mine.toml",
        "next: twin init press.toml --robot mine.toml",
        "next: twin run press.toml",
    ]
    written = twin("init", "press.toml", "--robot", "mine.toml", cwd=tmp_path)
    assert written.stdout == "press.toml\nnext: twin run press.toml\n", written.stderr
    ran = twin("run", "press.toml", "--json", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "4.9" in ran.stdout


def test_robot_and_experiment_are_written_at_once_wherever_the_experiment_is(tmp_path: Path):
    done = twin("init", "sub/press.toml", "--robot", "mine.toml", *LENGTHS, "--from", "pressing", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert 'extends = "../mine.toml"' in (tmp_path / "sub" / "press.toml").read_text()
    assert twin("run", "sub/press.toml", cwd=tmp_path).returncode == 0


def test_an_experiment_that_exists_leaves_no_new_robot_behind(tmp_path: Path):
    (tmp_path / "press.toml").write_text("")
    done = twin("init", "press.toml", "--robot", "mine.toml", *LENGTHS, cwd=tmp_path)
    assert done.returncode == 2 and "press.toml: exists" in done.stderr
    done = twin("init", "mine.toml", "--robot", "mine.toml", *LENGTHS, cwd=tmp_path)
    assert done.returncode == 2 and not (tmp_path / "mine.toml").exists()


def test_a_robot_that_cannot_be_is_refused_in_one_sentence(tmp_path: Path):
    for words, told in (
        (
            ["--robot", "mine.toml", "--lengths-mm", "a=nan", "b=35", "l_a=100", "l_b=180"],
            "--lengths-mm a=nan: expected",
        ),
        (
            ["--robot", "mine.toml", "--lengths-mm", "a=8_0", "b=35", "l_a=100", "l_b=180"],
            "--lengths-mm a=8_0: expected a number",
        ),
        (["--robot", "mine.toml", *LENGTHS, "--masses-g", "m_p=0"], "--masses-g m_p=0: expected"),
        ([*LENGTHS], "expected --robot my_robot.toml"),
        (["--masses-g", "m_p=1"], "expected --robot my_robot.toml"),
        (["--robot", "nobody.toml"], "nobody.toml: no such robot file"),
    ):
        done = twin("init", *words, cwd=tmp_path)
        assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert not list(tmp_path.iterdir())


def test_a_robot_that_may_swing_gets_the_note_of_its_page(tmp_path: Path):
    soft = "init", "--robot", "soft.toml", *LENGTHS, "--masses-g", "m_p=400", "--set", "robot.k_s_Nm_per_rad=0.8"
    told = " ".join(twin(*soft, cwd=tmp_path).stdout.split())
    assert "note: a natural frequency below 6 Hz: with the shipped gains the platform may swing" in told
    written = twin("init", "press.toml", "--robot", "soft.toml", cwd=tmp_path)
    assert written.returncode == 0 and "note: a natural frequency below 6 Hz" in written.stdout, written.stderr
    page = twin("robot", "soft.toml", "--no-rank", cwd=tmp_path)
    sentence = written.stdout.splitlines()[1].removeprefix("note: ")
    assert sentence in " ".join(page.stdout.split())


def test_the_page_of_a_robot(tmp_path: Path):
    assert twin("init", "--robot", "mine.toml", *LENGTHS, cwd=tmp_path).returncode == 0
    done = twin("robot", "mine.toml", "--no-rank", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["name"] == "mine" and facts["pose"] == [0.0, 0.0, -0.145]
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.glob("results/robot/mine/*"))] == [
        "results/robot/mine/robot.json", "results/robot/mine/robot.png"
    ]  # fmt: skip
    refused = twin("robot", "nobody.toml", cwd=tmp_path)
    assert refused.returncode == 2 and refused.stderr == "nobody.toml: no such experiment file\n"
