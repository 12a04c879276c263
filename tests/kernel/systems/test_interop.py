"""Systems of libcosim and Maestro, and any system as SSP, run with the same bits."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.systems.archives import archive, component, connection, connector, line, structure, system, values
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import Recording, read
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.studies.systems.recorded import record_system, write_system

NAMESPACE = 'xmlns="http://opensimulationplatform.com/MSMI/OSPSystemStructure" version="0.1"'
SIMULATORS = (
    '<Simulators><Simulator name="a" source="{ideal}" stepSize="0.001"><InitialValues><InitialValue '
    'variable="omega_ref"><Real value="1.5"/></InitialValue></InitialValues></Simulator>'
    '<Simulator name="b" source="{ideal}" stepSize="0.002"/></Simulators>'
)
# the input stands first: direction follows the FMUs
DIRECT = (
    '<VariableConnection><Variable simulator="b" name="omega_ref"/><Variable simulator="a" name="omega_m"/>'
    "</VariableConnection>"
)
BENT = (
    '<SignalConnection><Variable simulator="a" name="omega_m"/><Signal function="f" name="in"/></SignalConnection>'
    '<SignalConnection><Signal function="f" name="out"/><Variable simulator="b" name="omega_ref"/></SignalConnection>'
)
FUNCTION = '<Functions><LinearTransformation name="f" factor="-2" offset="0.5"/></Functions>'
TIMES = "<StartTime>0</StartTime><EndTime>0.01</EndTime><BaseStepSize>0.001</BaseStepSize>"


def osp(folder: Path, ideal: Path, connections: str, functions: str = "", times: str = TIMES) -> Path:
    file = folder / "OspSystemStructure.xml"
    file.write_text(
        f"<OspSystemStructure {NAMESPACE}>{times}{SIMULATORS.format(ideal=ideal)}{functions}"
        f"<Connections>{connections}</Connections></OspSystemStructure>"
    )
    return file


def model(folder: Path, ideal: Path, **more: Any) -> Path:
    file = folder / "mm.json"
    content = {
        "fmus": {"{x}": str(ideal), "{y}": str(ideal)},
        "connections": {"{x}.a.omega_m": ["{y}.b.omega_ref"]},
        "parameters": {"{x}.a.omega_ref": 1.5},
        "algorithm": {"type": "fixed-step", "size": 0.001},
        "endTime": 0.01,
    }
    file.write_text(json.dumps(content | more))
    return file


def run(file: Path, out: Path, choice: MasterChoice | None = None, **more: Any) -> tuple[Recording, dict[str, Any]]:
    came = record_system(DirectReporter(lambda note: None), file, choice or MasterChoice(), out, **more)
    return read(out / "run.mcap"), came.facts


def same(one: Recording, other: Recording) -> None:
    assert list(one.fields()) == list(other.fields())
    for key in one.fields():
        np.testing.assert_array_equal(one[key], other[key])


def test_a_system_of_libcosim_runs_as_its_master_does(tmp_path: Path, ideal: Path):
    recording, facts = run(osp(tmp_path, ideal, DIRECT), tmp_path / "run")
    assert (facts["form"], facts["scheme"], facts["tick_s"]) == ("OSP system structure", "jacobi", 0.001)
    assert facts["components"]["b"]["step_s"] == 0.002
    # b's step of 2 ms sees what a had come to at its start
    np.testing.assert_array_equal(recording["b.omega_m"][:6], [0, 0, 0, 0, 1.5, 1.5])
    folder, _ = run(tmp_path, tmp_path / "folder")
    same(folder, recording)


def test_functions_of_libcosim_are_lines_on_connections(tmp_path: Path, ideal: Path):
    recording, _ = run(osp(tmp_path, ideal, BENT, FUNCTION), tmp_path / "run")
    assert recording["b.omega_m"][-1] == 0.5 - 2 * 1.5


def test_a_multi_model_of_maestro_runs_and_says_what_is_not_read(tmp_path: Path, ideal: Path):
    file = model(tmp_path, ideal, livestream={}, parallelSimulation=True)
    recording, facts = run(file, tmp_path / "run")
    assert (facts["form"], facts["scheme"], facts["tick_s"]) == ("Maestro multi-model", "jacobi", 0.001)
    assert facts["unsaid"] == ["not read: livestream, parallelSimulation"]
    np.testing.assert_array_equal(recording["b.omega_m"][:4], [0, 0, 1.5, 1.5])
    # the same instance name of two FMUs
    twins = {"connections": {"{x}.a.omega_m": ["{y}.a.omega_ref"]}, "algorithm": {"type": "var-step"}}
    _, facts = run(model(tmp_path, ideal, **twins), tmp_path / "twins")
    assert list(facts["components"]) == ["x_a", "y_a"]
    assert facts["unsaid"] == ["algorithm var-step; steps of one length instead"]


INNER = system(
    [component("shaft", "a.fmu")],
    [connection("speed", "shaft.omega_ref"), connection("shaft.omega_m", "turned")],
    [connector("speed", "input", "rpm"), connector("turned", "output")],
    name="joint",
)
NESTED = structure(
    system(
        [component("a", "a.fmu", bindings=values("omega_ref=60 rpm")), INNER, component("b", "a.fmu")],
        [connection("a.omega_m", "joint.speed", line(3.0, -1.0)), connection("joint.turned", "b.omega_ref")],
        bindings=values("b.theta_m=90 deg"),
    ),
    0.01,
)


@pytest.mark.parametrize("kind", ["osp", "maestro", "fmu", "ssp"])
def test_what_is_written_as_ssp_runs_with_the_same_bits(kind: str, tmp_path: Path, ideal: Path):
    file = {
        "osp": lambda: osp(tmp_path, ideal, BENT, FUNCTION),
        "maestro": lambda: model(tmp_path, ideal),
        "fmu": lambda: ideal,
        "ssp": lambda: archive(tmp_path / "x.ssp", NESTED, {"a.fmu": ideal}),
    }[kind]()
    first = "omega_ref" if kind == "fmu" else "a.omega_ref"
    asked = Additions([f"{first}=0.1"])
    other: dict[str, dict[str, Any]] = {
        "osp": {"scheme": "gauss_seidel", "order": ["b"]},
        "ssp": {"scheme": "jacobi"},
    }
    choice = MasterChoice(0.0005, None, 0.012, **other.get(kind, {}))
    recording, facts = run(file, tmp_path / "run", choice, additions=asked)
    written = tmp_path / "written.ssp"
    told = write_system(file, choice, written, additions=asked)
    assert told.facts["ssp"] == str(written)
    again, others = run(written, tmp_path / "again")
    same(again, recording)
    assert (others["scheme"], others["tick_s"]) == (facts["scheme"], 0.0005)
    assert list(others["components"]) == list(facts["components"])
    # and once more, byte for byte but for the name
    twice = write_system(written, out=tmp_path / "twice.ssp").facts["ssp"]
    same(run(Path(twice), tmp_path / "third")[0], recording)
    with pytest.raises(InputRefused, match=r"written\.ssp: is there already"):
        write_system(file, choice, written)


def test_what_is_written_is_of_the_standard(tmp_path: Path, ideal: Path):
    from fmpy.ssp.ssd import read_ssd

    written = tmp_path / "written.ssp"
    write_system(osp(tmp_path, ideal, BENT, FUNCTION), out=written)
    # validates by the schema of SSP 1.0
    read = read_ssd(str(written))
    assert [one.name for one in read.system.elements] == ["a", "b"] and len(read.system.connections) == 1
    with zipfile.ZipFile(written) as packed:
        assert sorted(packed.namelist()) == ["SystemStructure.ssd", "resources/ideal_velocity.fmu"]


@pytest.mark.parametrize(
    ("asked", "option"),
    [
        (Additions(inputs=["omega_ref=t"]), "--input omega_ref"),
        (Additions(recorded=["*"]), "--record"),
        (MasterChoice(solver="rk4"), "--solver"),
        (MasterChoice(loops="solve"), "--loops solve"),
    ],
)
def test_what_ssp_has_no_word_for_is_refused(asked: Additions | MasterChoice, option: str, tmp_path: Path, ideal: Path):
    choice, added = (asked, Additions()) if isinstance(asked, MasterChoice) else (MasterChoice(), asked)
    with pytest.raises(InputRefused, match=f"{option}: an SSP archive has no word for it"):
        write_system(ideal, choice, tmp_path / "x.ssp", additions=added)
    assert not (tmp_path / "x.ssp").exists()


GROUP = '<VariableGroupConnection><VariableGroup simulator="a" name="g"/></VariableGroupConnection>'
BAD_OSP = {
    "a sum": ("", '<Functions><Sum name="s" inputCount="2"/></Functions>', "<Sum> s: a sum of signals, which is not"),
    "a group": (GROUP, "", "<VariableGroupConnection>: a connection of groups, which other files define"),
    "no simulator": (DIRECT.replace('"b"', '"c"'), "", "no simulator 'c'; it has a, b"),
    "no function": (BENT, "", "no function 'f'"),
    "nothing in": (BENT[BENT.index("</SignalConnection>") + 19 :], FUNCTION, "nothing gets into the function 'f'"),
    "no variable": (DIRECT.replace("omega_m", "omega"), "", "a.omega: ideal_velocity.fmu has no such variable"),
}


@pytest.mark.parametrize("bad", BAD_OSP)
def test_a_system_of_libcosim_that_cannot_be_read_is_refused(bad: str, tmp_path: Path, ideal: Path):
    connections, functions, told = BAD_OSP[bad]
    with pytest.raises(InputRefused) as refused:
        run(osp(tmp_path, ideal, connections, functions), tmp_path / "run")
    assert told in str(refused.value) and "OspSystemStructure.xml" in str(refused.value)


def test_sources_that_are_no_files_are_refused(tmp_path: Path):
    for source, told in (("proxyfmu://localhost?file=a.fmu", "is not a file; expected an FMU on this machine"),
                         ("none.fmu", "no such FMU at")):  # fmt: skip
        with pytest.raises(InputRefused, match="source") as refused:
            run(osp(tmp_path, Path(source), ""), tmp_path / "run")
        assert told in str(refused.value)


BAD_MODELS: dict[str, tuple[dict[str, Any], str]] = {
    "no FMUs": ({"fmus": {}}, 'no "fmus"; expected a multi-model of Maestro'),
    "no file": ({"fmus": {"{x}": "none.fmu"}}, "{x}: no such FMU: none.fmu"),
    "a name": (
        {"connections": {"x.a.omega_m": ["{y}.b.omega_ref"]}},
        "'x.a.omega_m'; expected {fmu}.instance",
    ),
    "a key": ({"parameters": {"{z}.a.k": 1}}, "'{z}.a.k': no FMU {z}; it has {x}, {y}"),
    "a value": ({"parameters": {"{x}.a.omega_ref": None}}, "{x}.a.omega_ref = None; expected a number, true, false"),
    "a step": ({"algorithm": {"type": "fixed-step", "size": 0}}, "algorithm size = 0; expected a number > 0"),
    "an end": ({"endTime": "late"}, "endTime = 'late'; expected a number"),
}


@pytest.mark.parametrize("bad", BAD_MODELS)
def test_a_multi_model_that_cannot_be_read_is_refused(bad: str, tmp_path: Path, ideal: Path):
    more, told = BAD_MODELS[bad]
    with pytest.raises(InputRefused) as refused:
        run(model(tmp_path, ideal, **more), tmp_path / "run")
    assert told in str(refused.value) and "mm.json" in str(refused.value)
