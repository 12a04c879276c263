from pathlib import Path

import pytest

from twin.errors import InputRefused
from twin.experiment.source import located, override, read_source, replace_drive


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
    override(source, ["k=3.5"])
    assert source.values == {"k": 3.5}
    assert source.origins["k"] == "set on the command line"


def test_an_override_reads_toml_and_bare_words(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", ""))
    override(source, ["a.b.c=[1, 2]", "mode=position", "flag=true"])
    assert source.values == {"a": {"b": {"c": (1, 2)}}, "mode": "position", "flag": True}


@pytest.mark.parametrize("text", ["novalue", "=3"])
def test_an_override_without_key_or_value_is_refused(tmp_path: Path, text: str):
    source = read_source(write(tmp_path, "e.toml", ""))
    with pytest.raises(InputRefused, match="expected key=value"):
        override(source, [text])


def test_files_that_extend_each_other_are_refused(tmp_path: Path):
    write(tmp_path, "a.toml", 'extends = "b.toml"')
    b = write(tmp_path, "b.toml", 'extends = "a.toml"')
    with pytest.raises(InputRefused, match="circle"):
        read_source(b)


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
    assert located("fmus", inner) == tmp_path / "fmus"
    assert located("nowhere", inner) == inner / "nowhere"


def test_another_drive_brings_its_own_parameters(tmp_path: Path):
    source = read_source(write(tmp_path, "e.toml", '[drive]\nfmu = "x"\n[drive.parameters]\ndroop = 0.6\n'))
    replace_drive(source, "y.fmu")
    assert source.values["drive"].keys() == {"fmu"}
    assert not any(key.startswith("drive.parameters") for key in source.origins)


def test_a_file_that_names_another_drive_keeps_nothing_of_the_one_it_extends(tmp_path: Path):
    write(tmp_path, "base.toml", '[drive]\nfmu = "x"\n[drive.parameters]\ndroop = 0.6\n')
    other = write(tmp_path, "other.toml", 'extends = "base.toml"\n[drive]\nfmu = "y"\n')
    assert read_source(other).values["drive"] == {"fmu": "y"}
    tuned = write(tmp_path, "tuned.toml", 'extends = "base.toml"\n[drive.parameters]\ndroop = 0.3\n')
    assert read_source(tuned).values["drive"] == {"fmu": "x", "parameters": {"droop": 0.3}}
