"""Several FMUs on the command line: wires by name, by dimension, in their order; and text that is no path or URL."""

import json
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.fmi.odd import odd_fmu
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read
from twin.kernel.systems.reading import read_system
from twin.studies.systems.joined import join_fmus


def wires(*fmus: Path) -> list[str]:
    package, _ = join_fmus(fmus)
    return [f"{'.'.join(one.start)} -> {'.'.join(one.end)}" for one in package.structure.system.connections]


def test_the_only_output_of_the_fmus_before_feeds_an_input(tmp_path: Path):
    a, b = odd_fmu(tmp_path / "A.fmu"), odd_fmu(tmp_path / "B.fmu")
    assert wires(a, b) == ["A.out_Real -> B.in_Real"]
    assert wires(b, a) == ["B.out_Real -> A.in_Real"]


def test_two_fmus_of_one_name_are_two_components_of_the_system(tmp_path: Path):
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        odd_fmu(tmp_path / folder / "A.fmu")
    done = twin("cosim", "one/A.fmu", "other/A.fmu", "--set", "A.in_Real=2", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    run = read(tmp_path / facts["recording"])
    assert list(facts["components"]) == ["A", "A_2"]
    assert run["A.out_Real"][-1] == run["A_2.out_Real"][-1] == 2.0


def test_what_is_no_fmu_or_has_nothing_to_join_is_refused(tmp_path: Path):
    a, two = odd_fmu(tmp_path / "A.fmu"), odd_fmu(tmp_path / "two.fmu", types=("Real", "Integer"))
    with pytest.raises(InputRefused, match="several files must all be FMUs"):
        join_fmus([a, tmp_path / "x.ssp"])
    with pytest.raises(InputRefused, match="no output has the name"):
        join_fmus([two, a])


@pytest.mark.parametrize("source", ["file://[x", "x" * 300, "file:///\0"])
def test_a_source_of_a_multi_model_that_is_no_path_is_refused(tmp_path: Path, source: str):
    file = tmp_path / "m.json"
    file.write_text(json.dumps({"fmus": {"{a}": source}}))
    with pytest.raises(InputRefused, match=r"\{a\}"):
        read_system(file)


@pytest.mark.parametrize("source", ["http://[::1", "x" * 300])
def test_a_source_of_a_system_structure_that_is_no_path_is_refused(tmp_path: Path, source: str):
    file = tmp_path / "OspSystemStructure.xml"
    file.write_text(
        f'<OspSystemStructure><Simulators><Simulator name="a" source="{source}"/></Simulators></OspSystemStructure>'
    )
    with pytest.raises(InputRefused, match="source"):
        read_system(file)
