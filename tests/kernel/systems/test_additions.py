"""Values, inputs over time and patterns of recording, as the command line says them."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.kernel.systems.archives import component, connection, connector, structure, system, values
from tests.kernel.systems.conftest import Ran
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import Recording, read
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.studies.systems.recorded import record_system, system_result

A, B = component("a", "a.fmu"), component("b", "a.fmu")
WIRE = connection("a.omega_m", "b.omega_ref")
BOTH = structure(system([A, B], [WIRE]), 0.01)
Alone = Callable[..., tuple[Recording, dict[str, Any]]]


@pytest.fixture
def alone(tmp_path: Path, ideal: Path) -> Alone:
    """Runs one FMU: `ideal`, or another one."""

    def run(fmu: Path = ideal, stop: float | None = 0.01, **asked: Any) -> tuple[Recording, dict[str, Any]]:
        out = tmp_path / f"alone_{len(list(tmp_path.iterdir()))}"
        choice = MasterChoice(asked.pop("tick", None), None, stop)
        hear = DirectReporter(lambda note: None)
        came = record_system(hear, fmu, choice, out, additions=Additions(**asked))
        return read(out / "run.mcap"), came.facts

    return run


def test_one_fmu_is_a_system_that_is_called_as_its_file(alone: Alone, ran: Ran, ideal: Path):
    run, facts = alone(settings=["omega_ref=1.5"], stop=0.01)
    in_ssp, _ = ran(
        structure(system([component("ideal_velocity", "a.fmu")], bindings=values("ideal_velocity.omega_ref=1.5")), 0.01)
    )
    assert list(run.streams) == ["ideal_velocity"] and facts["form"] == "FMU"
    for key in in_ssp.fields():
        np.testing.assert_array_equal(run[key], in_ssp[key])
    assert system_result(facts).text.splitlines()[1] == "  system     FMU, 0 connections"


def test_an_fmu_runs_as_its_default_experiment_says_and_in_500_steps_if_it_states_none(
    alone: Alone, ideal: Path, tmp_path: Path
):
    silent = redescribed(ideal, tmp_path / "silent.fmu", ' stopTime="1.0" stepSize="0.001"', ' stopTime="2"')
    _, facts = alone(silent, stop=None)
    assert facts["simulated_s"] == 2.0 and facts["tick_s"] == 0.002 and "as the FMU states none" in facts["tick_from"]
    # 1.7 s / 500 = 3.4 ms
    assert alone(silent, stop=1.7)[1]["tick_s"] == 0.002
    endless = redescribed(ideal, tmp_path / "endless.fmu", ' stopTime="1.0"', "")
    with pytest.raises(InputRefused, match="neither the structure nor an FMU states a stop time"):
        alone(endless, stop=None)


def _ssv(file: Path, parameters: str) -> Path:
    file.write_text(
        '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" '
        f'name="v"><ssv:Parameters>{parameters}</ssv:Parameters></ssv:ParameterSet>'
    )
    return file


def test_values_are_set_over_those_of_the_file_and_of_ssv_files(ran: Ran, tmp_path: Path):
    ssv = _ssv(
        tmp_path / "v.ssv",
        '<ssv:Parameter name="a.omega_ref"><ssv:Real value="2"/></ssv:Parameter>'
        '<ssv:Parameter name="b.theta_m"><ssv:Real value="90" unit="deg"/></ssv:Parameter>'
        '<ssv:Parameter name="c.x"><ssv:Real value="1"/></ssv:Parameter>',
    )
    whole = structure(system([component("a", "a.fmu", bindings=values("omega_ref=1")), B], [WIRE]), 0.01)
    run, facts = ran(whole, additions=Additions(parameters=[ssv]))
    assert run["a.omega_m"][-1] == 2.0 and run["b.theta_m"][0] == pytest.approx(math.pi / 2)
    assert facts["ignored"] == ["c.x"]
    run, _ = ran(whole, additions=Additions(["a.omega_ref=60[rpm]", "b.theta_m=-1"], [ssv]))
    assert run["a.omega_m"][-1] == pytest.approx(2 * math.pi) and run["b.theta_m"][0] == -1.0


def test_what_is_set_and_fed_by_a_connection_is_named(ran: Ran, tmp_path: Path):
    settings = ["a.omega_ref=2", "b.omega_ref=3"]
    run, facts = ran(BOTH, additions=Additions(settings))
    assert facts["overruled"] == ["b.omega_ref=3"] and run["b.omega_m"][-1] == 2.0
    assert "overruled  b.omega_ref=3, by connections" in system_result(facts).text
    ssv = _ssv(tmp_path / "v.ssv", '<ssv:Parameter name="b.omega_ref"><ssv:Real value="3"/></ssv:Parameter>')
    assert ran(BOTH, additions=Additions(settings[:1], [ssv]))[1]["overruled"] == ["b.omega_ref"]


def test_a_connector_of_the_system_takes_values_and_signals_for_what_it_leads_to(ran: Ran):
    ends = [connection("speed", "a.omega_ref"), connection("speed", "b.omega_ref")]
    whole = structure(system([A, B], ends, [connector("speed", "input", "rpm")]), 0.01)
    run, _ = ran(whole, additions=Additions(["speed=60"]))
    assert run["a.omega_m"][-1] == run["b.omega_m"][-1] == pytest.approx(2 * math.pi)
    run, _ = ran(whole, additions=Additions(inputs=["speed=60*step(0.005)"]))
    assert run["b.omega_m"][5] == 0.0 and run["b.omega_m"][6] == pytest.approx(2 * math.pi)
    assert run.fields()["inputs.speed"].unit == "rpm" and run["inputs.speed"][5] == 60.0


def test_an_input_follows_an_expression_of_time_from_the_step_in_which_it_holds(alone: Alone):
    run, facts = alone(inputs=["omega_ref=1 + 2*step(0.003)"])
    # the speed at the end of a step is the command at its start
    np.testing.assert_array_equal(run["ideal_velocity.omega_m"][1:], [1, 1, 1, 3, 3, 3, 3, 3, 3, 3])
    assert facts["inputs"] == {"omega_ref": "1 + 2*step(0.003)"} and "ideal_velocity.omega_ref" not in facts["not_fed"]


@pytest.mark.parametrize("length", [255, 256, 257, 1000])
def test_an_expression_may_be_longer_than_a_file_name(alone: Alone, length: int):
    text = "1 + 2*step(0.003)" + " + 0" * ((length - 17) // 4)
    run, _ = alone(inputs=[f"omega_ref={text.rjust(length, '+')}"])
    np.testing.assert_array_equal(run["ideal_velocity.omega_m"][1:], [1, 1, 1, 3, 3, 3, 3, 3, 3, 3])
    for given, told in ((f"omega_ref={'u' * length}", "--input omega_ref"), ("u" * length, "expected NAME=SOURCE")):
        with pytest.raises(InputRefused, match=told):
            alone(inputs=[given])


@pytest.mark.parametrize("by", ["omega_ref={}", "{}", "ideal_velocity.omega_ref={}:omega_ref"])
def test_columns_of_a_csv_file_are_joined_by_lines_for_a_continuous_input(alone: Alone, tmp_path: Path, by: str):
    file = tmp_path / "in.csv"
    file.write_text("time,omega_ref,other\n0,0,1\n0.004,4,1\n0.004,10,1\n")
    run, facts = alone(inputs=[by.format(file)])
    np.testing.assert_allclose(run["ideal_velocity.omega_m"][1:], [0, 1, 2, 3, 10, 10, 10, 10, 10, 10], atol=1e-12)
    assert facts["ignored"] == (["in.csv: other"] if by == "{}" else [])


@pytest.mark.parametrize("first", [-3.0, 5.0, 1.7e9])
def test_an_input_without_a_time_inside_the_run_is_refused(alone: Alone, tmp_path: Path, first: float):
    file = tmp_path / "in.csv"
    file.write_text(f"t_s,omega_ref\n{first!r},1\n{first + 1.0!r},2\n")
    with pytest.raises(InputRefused, match=r"--input omega_ref: its samples are from .* the run from 0 to 0\.01 s"):
        alone(inputs=[f"omega_ref={file}"])
    # one that ends as the run begins, or begins as it ends, is inside
    for t in (-1.0, 0.01):
        file.write_text(f"t_s,omega_ref\n{t!r},1\n{t + 1.0!r},2\n")
        alone(inputs=[f"omega_ref={file}"])


def test_what_is_not_continuous_is_held_between_samples(alone: Alone, ideal: Path, tmp_path: Path):
    speed = 'name="omega_ref" valueReference="0" causality="input" variability="continuous"'
    stepped = redescribed(ideal, tmp_path / "d.fmu", speed, speed.replace("continuous", "discrete"))
    file = tmp_path / "in.csv"
    file.write_text("t_ms;u [rpm]\n0;0\n4;60\n")
    run, _ = alone(stepped, inputs=[f"omega_ref={file}:u"])
    np.testing.assert_allclose(run["d.omega_m"][1:], [0] * 4 + [2 * math.pi] * 6, rtol=1e-14)


def test_a_recording_feeds_an_input_in_its_units(alone: Alone, tmp_path: Path):
    first, _ = alone(inputs=["omega_ref=sin(1000*t)"])
    run, _ = alone(inputs=[f"omega_ref={first.path}:ideal_velocity.omega_m"])
    np.testing.assert_array_equal(run["ideal_velocity.omega_m"][1:], first["ideal_velocity.omega_m"][:-1])
    with pytest.raises(InputRefused, match="from 'rad' to 'rad/s', which have different dimensions"):
        alone(inputs=[f"omega_ref={first.path}:ideal_velocity.theta_m"])


def test_a_table_in_an_archive_is_a_component(ran: Ran, tmp_path: Path):
    file = tmp_path / "road.csv"
    file.write_text("time, road\n0, 0\n0.01, 10\n")
    table = component("table", "resources/road.csv", [connector("road", "output")], more='type="application/table"')
    whole = system([A, table], [connection("table.road", "a.omega_ref")])
    run, facts = ran(structure(whole, 0.01), {"resources/road.csv": file})
    np.testing.assert_allclose(run["a.omega_m"][1:], np.arange(10.0), atol=1e-12)
    np.testing.assert_allclose(run["table.road"], np.arange(11.0), atol=1e-12)
    assert list(facts["components"]) == ["a"]
    with pytest.raises(InputRefused, match=r"resources/road\.csv has no column 'rod'; did you mean 'road'"):
        ran(structure(system([A, table], [connection("table.rod", "a.omega_ref")]), 0.01), {"resources/road.csv": file})


def test_patterns_choose_what_is_recorded_of_every_causality(ran: Ran):
    run, _ = ran(BOTH, additions=Additions(["a.omega_ref=2"], recorded=["*.omega_*", "b.theta_m"]))
    assert list(run.fields()) == ["a.omega_ref", "a.omega_m", "b.omega_ref", "b.theta_m", "b.omega_m"]
    # an input is what was given for the step that ends here
    assert run["b.omega_ref"][-1] == 2.0
    plain, _ = ran(BOTH, additions=Additions(["a.omega_ref=2"]))
    np.testing.assert_array_equal(run["b.omega_m"], plain["b.omega_m"])
    only, _ = ran(BOTH, additions=Additions(["a.omega_ref=2"], recorded=["b.omega_m"]))
    assert list(only.streams) == ["b"]
    np.testing.assert_array_equal(only["b.omega_m"], plain["b.omega_m"])


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no value": ({"settings": ["a.omega_ref"]}, "--set a.omega_ref: expected NAME=VALUE"),
    "no component": ({"settings": ["c.omega_ref=1"]}, "x.ssp has no component of this name"),
    "no variable": ({"settings": ["a.omega=1"]}, "a has no variable 'omega'; did you mean 'omega_ref'?"),
    "no number": ({"settings": ["a.omega_ref=fast"]}, "--set a.omega_ref=fast: omega_ref is Real; expected a finite"),
    "not finite": ({"settings": ["a.omega_ref=nan"]}, "expected a finite number"),
    "another unit": ({"settings": ["a.omega_ref=1[N.m]"]}, "from 'N.m' to 'rad/s', which have different dimensions"),
    "twice": ({"settings": ["a.omega_ref=1", "a.omega_ref=2"]}, "--set a.omega_ref is given twice, 1 and 2"),
    "set and fed": (
        {"settings": ["a.omega_ref=1"], "inputs": ["a.omega_ref=t"]},
        "--input a.omega_ref and --set a.omega_ref contradict each other; remove one",
    ),
    "fed by a wire": ({"inputs": ["b.omega_ref=t"]}, "is fed already, by the connection from a.omega_m; remove one"),
    "fed twice": (
        {"inputs": ["a.omega_ref=t", "a.omega_ref=1"]},
        "--input a.omega_ref: a.omega_ref is fed already, by --input a.omega_ref; remove one of both",
    ),
    "an output fed": ({"inputs": ["a.omega_m=t"]}, "--input a.omega_m: it is output; expected an input"),
    "no expression": ({"inputs": ["a.omega_ref=stop(1)"]}, "--input a.omega_ref: 'stop' is not known; did you mean"),
    "no file": ({"inputs": ["a.omega_ref=none.csv"]}, "none.csv: no such file"),
    "no source": ({"inputs": ["a.omega_ref"]}, "--input a.omega_ref: expected NAME=SOURCE, such as u=step(1.0)"),
    "no column": ({"inputs": ["a.omega_ref=in.csv:w"]}, "in.csv has no column 'w'; it has v, x"),
    "no column of an input": ({"inputs": ["in.csv"]}, "--input in.csv: no input is called v, x"),
    "backwards": ({"inputs": ["a.omega_ref=back.csv:v"]}, "back.csv line 3: time runs backwards from 1 s to 0 s"),
    "no time": ({"inputs": ["a.omega_ref=timeless.csv:v"]}, "timeless.csv: no column of time; it has a, v"),
    "words": ({"inputs": ["a.omega_ref=words.csv:v"]}, "words.csv line 3: column 'v' holds 'x'; expected a finite"),
    "a pattern of nothing": ({"recorded": ["*.omega"]}, "--record *.omega: no variable of x.ssp is called so"),
    "no SSV": ({"parameters": [Path("in.csv")]}, "in.csv"),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
def test_what_cannot_be_added_is_refused_before_anything_is_written(
    bad: str, ideal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from tests.kernel.systems.archives import archive

    added, told = BAD[bad]
    archive(tmp_path / "x.ssp", BOTH, {"a.fmu": ideal})
    for name, text in (("in", "time,v,x\n0,0,0\n1,1,1\n"), ("back", "t,v\n1,0\n0,0\n"), ("timeless", "a,v\n0,0\n1,1\n"),
                       ("words", "t,v\n0,1\n1,x\n")):  # fmt: skip
        (tmp_path / f"{name}.csv").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputRefused) as refused:
        record_system(DirectReporter(lambda note: None), Path("x.ssp"), additions=Additions(**added))
    assert told in str(refused.value)
    assert not (tmp_path / "results").exists()


def test_whole_numbers_and_truth_values_take_no_others(ideal: Path, tmp_path: Path, alone: Alone):
    load = 'valueReference="1" causality="input" variability="continuous"'
    text = redescribed(ideal, tmp_path / "i.fmu", '<Real start="0.0" unit="N.m" />', '<Integer start="0" />')
    whole = redescribed(text, tmp_path / "whole.fmu", load, load.replace("continuous", "discrete"))
    for asked, told in (
        ({"settings": ["tau_load=2.5"]}, "--set tau_load=2.5: tau_load is Integer; expected a whole number"),
        (
            {"inputs": [f"tau_load={tmp_path / 'in.csv'}:v"]},
            "0.5 for tau_load, which is Integer; expected whole numbers",
        ),
    ):
        (tmp_path / "in.csv").write_text("t,v\n0,0\n1,0.5\n")
        with pytest.raises(InputRefused) as refused:
            alone(whole, **asked)
        assert told in str(refused.value)
