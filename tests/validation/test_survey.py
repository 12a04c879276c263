import json
import re
from pathlib import Path

import pytest

from tests.kernel.fmi.archives import altered, carrying, redescribed
from twin.kernel.errors import InputRefused
from twin.kernel.files import read_json, read_toml
from twin.kernel.process.guard import JobFailure
from validation import survey as module
from validation.survey import OUTCOME_MEANINGS, main, page_text, stated, survey, survey_text, tried

WALL = 60.0


def test_the_page_says_what_the_data_say(root: Path):
    facts = read_json(root / "docs" / "compatibility.json")
    page = page_text(facts)
    assert page.startswith("# Which FMUs work") and all(row["sha256"][:8] in page for row in facts["fmus"])
    assert {row["word"] for row in facts["fmus"]} <= set(OUTCOME_MEANINGS)
    assert set(facts["sources"]) == {row["source"] for row in facts["fmus"]}
    told = read_toml(root / "docs" / "compatibility.toml")
    assert facts["sources"] == {name: told[name]["from"] for name in facts["sources"]}


def test_the_data_name_no_place_of_the_machine_they_were_made_on(root: Path):
    text = (root / "docs" / "compatibility.json").read_text()
    # an absolute path, wherever it leads; that of an address comes after its host
    assert re.findall(r"(?<![\w./:-])/\w[\w.-]*/", text) == []


def test_every_fmu_is_tried_once_and_one_that_crashes_costs_itself(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    place = tmp_path / "fmus"
    for folder in ("a", "b"):
        (place / folder).mkdir(parents=True)
        (place / folder / "servo.fmu").write_bytes(good.read_bytes())
    carrying(good, place / "a" / "plain.fmu", {})
    redescribed(good, place / "b" / "crash.fmu", 'modelName="velocity_servo"', 'modelName="crash"')
    (place / "b" / "pointer.fmu").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    (place / "b" / "text.fmu").write_text("no FMU")

    def here(job, arguments, limits, listen):
        """The job in this process; its crash is made up."""
        if arguments["file"].endswith("crash.fmu"):
            raise JobFailure(f"{arguments['file']}: crashed")
        reporter = type("Reporter", (), {"note": lambda self, **note: listen(note)})()
        return tried(reporter, **arguments)

    monkeypatch.setattr(module, "run_guarded", here)
    (tmp_path / "sources.toml").write_text('[a]\nfrom = "here"\n[b]\nfrom = "there"\n')
    data, page = tmp_path / "out" / "s.json", tmp_path / "out" / "s.md"
    facts = survey(place, tmp_path / "sources.toml", data, page, WALL)
    rows = {row["file"]: row for row in facts["fmus"]}
    assert {name: row["word"] for name, row in rows.items()} == {
        "servo.fmu": "agrees", "plain.fmu": "ran", "crash.fmu": "lost", "pointer.fmu": "refused", "text.fmu": "refused",
    }  # fmt: skip
    assert rows["servo.fmu"]["drive"] and rows["servo.fmu"]["kinds"] == ("co-simulation",)
    assert rows["servo.fmu"]["source"] == "a" and rows["plain.fmu"]["tried"] == "default experiment"
    assert str(tmp_path) not in data.read_text() and json.loads(data.read_text())["sources"] == {
        "a": "here",
        "b": "there",
    }
    assert "| agrees | 1 |" in page.read_text() and "5 FMUs: 1 agrees" in survey_text(facts)
    again = survey(data, None, data, tmp_path / "again.md", WALL)
    assert (tmp_path / "again.md").read_text() == page.read_text() and again["fmus"]


def test_a_folder_without_fmus_and_one_that_the_sources_do_not_know_are_refused(root: Path, tmp_path: Path):
    (tmp_path / "x.json").write_text("[]")
    (tmp_path / "a").mkdir()
    (tmp_path / "s.toml").write_text("")
    for place, told in (
        (tmp_path / "none", "no such folder"),
        (tmp_path / "a", "0 FMUs"),
        (tmp_path / "x.json", "no data"),
    ):
        with pytest.raises(InputRefused, match=told):
            survey(place, None, tmp_path / "d.json", None, WALL)
    (tmp_path / "a" / "x.fmu").write_text("x")
    with pytest.raises(InputRefused, match=r"s\.toml: nothing of a"):
        survey(tmp_path, tmp_path / "s.toml", tmp_path / "d.json", None, WALL)


def test_from_the_command_line_a_refusal_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(tmp_path), "--data", str(tmp_path / "d.json"), "--page", str(tmp_path / "d.md")]) == 2
    assert "0 FMUs below it" in capsys.readouterr().err


def test_words_of_strangers_are_no_markup():
    hostile = "<script>x</script> | [a](javascript:b) ![i](http://example.org/i) `c` *d* __e__"
    row = {"source": "s", "file": hostile, "sha256": "0" * 64, "drive": False, "tried": "nothing"}
    row |= {"word": "refused", "detail": hostile, "tool": hostile}
    page = page_text({"platform": "p", "sources": {"s": ""}, "fmus": [row]})
    (line,) = [line for line in page.splitlines() if "script" in line]
    assert "<script" not in line and "](" not in line.replace("\\](", "") and line.replace("\\|", "").count("|") == 7


def test_version_kind_and_platforms_are_told_of_any_fmu(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    found = stated(good)
    assert (found.model, found.tool, found.fmi, found.kinds) == ("velocity_servo", "", "2.0", ("co-simulation",))
    assert found.platforms == ("darwin64", "linux64", "win64")
    exchange = stated(redescribed(good, tmp_path / "me.fmu", "<CoSimulation", "<ModelExchange"))
    assert exchange.kinds == ("model exchange",)
    old = stated(redescribed(good, tmp_path / "old.fmu", 'fmiVersion="2.0"', 'fmiVersion="1.0" generationTool="T 1"'))
    assert (old.fmi, old.tool, old.kinds) == ("1.0", "T 1", ("model exchange",))


def test_what_has_no_description_is_no_fmu(root: Path, tmp_path: Path):
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    bad = altered(good, tmp_path / "bad.fmu", lambda n, c: None if n == "modelDescription.xml" else (n, c))
    with pytest.raises(InputRefused, match="not an FMU"):
        stated(bad)
