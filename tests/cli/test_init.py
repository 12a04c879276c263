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
