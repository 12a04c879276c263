"""Systems of others are tried as their files say, each by itself, and held to the numbers that stand beside them."""

import json
from pathlib import Path

import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.systems.archives import archive, component, connection, structure, system, values
from twin.kernel.files import read_json
from twin.kernel.process.job import JobLimits
from validation import systems as module
from validation.survey import page_text, survey
from validation.systems import system_row, systems_below, tried

A = component("a", "a.fmu", bindings=values("omega_ref=1"))
WIRE = connection("a.omega_m", "b.omega_ref")


@pytest.fixture
def place(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of systems, which are tried in this process."""

    def here(job, arguments, limits, listen):
        reporter = type("Reporter", (), {"note": lambda self, **note: listen(note)})()
        return tried(reporter, **arguments)

    monkeypatch.setattr(module, "run_guarded", here)
    fmu, home = root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu", tmp_path / "systems"
    for folder in ("some", "some/unpacked", "others"):
        (home / folder).mkdir(parents=True)
    for name in ("right", "wrong"):
        two = structure(system([A, component("b", "a.fmu")], [WIRE], name=name), 0.01)
        archive(home / f"some/{name}.ssp", two, {"a.fmu": fmu})
        (home / f"some/{name}.toml").write_text('tick = 0.001\nset = ["a.omega_ref=2"]\n')
    (home / "some/right_ref.csv").write_text("time,b.omega_m\n0.01,2.0\n")
    (home / "some/wrong_ref.csv").write_text("time,b.omega_m\n0,0\n0.01,2.1\n")
    (home / "fmus").mkdir()
    (home / "fmus/a.fmu").write_bytes(fmu.read_bytes())
    outside = structure(system([component("a", "../../fmus/a.fmu")]))
    (home / "some/unpacked/SystemStructure.ssd").write_text(outside)
    archive(home / "others/lacking.ssp", structure(system([component("a", "none.fmu")]), 1.0), {})
    (home / "others/mm.json").write_text(json.dumps({"fmus": {}, "connections": {}}))
    (home / "others/no.json").write_text("[]")
    return home


def test_every_kind_of_system_is_tried_as_it_is_asked_to_be(place: Path, tmp_path: Path):
    (tmp_path / "fmus.json").write_text(json.dumps({"platform": "here", "sources": {}, "fmus": []}))
    sources = tmp_path / "sources.toml"
    sources.write_text('[some]\nfrom = "here"\n[others]\nfrom = "there"\n')
    data, page = tmp_path / "d.json", tmp_path / "d.md"
    facts = survey(tmp_path / "fmus.json", sources, data, page, 60.0, place)
    rows = {row["file"]: row for row in facts["systems"]}
    assert {name: row["word"] for name, row in rows.items()} == {
        "right.ssp": "agrees", "wrong.ssp": "differs", "unpacked/SystemStructure.ssd": "ran", "lacking.ssp": "refused",
        "mm.json": "refused",
    }  # fmt: skip
    assert rows["right.ssp"] | {"sha256": ""} == {
        "source": "some", "file": "right.ssp", "form": "SSP 1.0", "parts": 2, "tried": "as its test asks", "sha256": "",
        "word": "agrees", "detail": "10 steps of 0.001 s; 1 signal, b.omega_m off by 0",
    }  # fmt: skip
    assert "off by 0.048" in rows["wrong.ssp"]["detail"]
    assert rows["lacking.ssp"]["detail"].endswith("its resource 'none.fmu' is not a file of this archive")
    assert read_json(data) == facts and page.read_text() == page_text(facts)
    assert "### Systems of some" in page.read_text() and "| agrees | 1 |" in page.read_text()


def test_one_that_states_no_end_is_given_one(root: Path, place: Path, tmp_path: Path):
    silent = structure(system([component("a", "a.fmu")]))
    fmu = tmp_path / "silent.fmu"
    redescribed(place / "fmus/a.fmu", fmu, ' stopTime="1.0" stepSize="0.001"', "")
    file = archive(tmp_path / "x.ssp", silent, {"a.fmu": fmu})
    found = system_row("x.ssp", file, JobLimits())
    assert (found["word"], found["tried"]) == ("ran", "1 s in steps of 10 ms, as it states none")
    assert found["detail"] == "100 steps of 0.01 s"
    assert [name.name for name, _ in systems_below(place / "others", tmp_path)] == ["lacking.ssp", "mm.json"]
