"""When a run begins and ends, in which steps and in which order: options, else the structure, else the FMUs."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.eventful import KINDS, maker
from tests.kernel.systems.archives import component, connection, structure, system, values
from tests.kernel.systems.conftest import Ran
from tests.kernel.systems.linear import Linear
from twin.kernel.errors import InputRefused
from twin.studies.systems.recorded import system_result

RAMP = Linear(a=[[0, 1], [0, 0]], c=[[1]], x0=[0, 1])
A = component("a", "a.fmu", bindings=values("omega_ref=1"))
B = component("b", "a.fmu")
SPEED = connection("a.omega_m", "b.omega_ref")


def noted(part: str, note: str) -> str:
    """A component with an annotation."""
    said = f'<ssd:Annotations><ssc:Annotation type="org.x">{note}</ssc:Annotation></ssd:Annotations>'
    return part.replace("</ssd:Component>", f"{said}</ssd:Component>")


def test_a_run_begins_where_it_is_asked_for_or_the_structure_says_and_time_stays_whole_ticks(ran: Ran, tmp_path: Path):
    # the FMU refuses a step that does not begin where it stands
    resources = {"r.fmu": RAMP.fmu(tmp_path / "r.fmu")}
    ssd = structure(system([component("r", "r.fmu")]), 3.0)
    for text, asked in ((ssd, {"start": 2.0}), (ssd.replace('startTime="0.0"', 'startTime="2"'), {})):
        run, facts = ran(text, resources, **asked)
        assert run.time("r").tolist() == pytest.approx([k * 0.01 for k in range(200, 301)], abs=1e-12)
        assert run["r.y"][-1] == pytest.approx(1.0, rel=1e-12)
        assert facts["start_s"] == 2.0 and facts["simulated_s"] == pytest.approx(1.0)
        assert "1 s from 2 s on at" in system_result(facts).text
    for kind in ("model_exchange", "co_simulation"):
        run, _ = ran(ssd, resources, start=2.0, kinds={"r": kind})
        assert run["r.y"][-1] == pytest.approx(1.0, rel=1e-5)


def test_a_run_from_a_start_goes_on_from_its_states_with_the_same_bits(ran: Ran, tmp_path: Path):
    ssd = structure(system([A, B], [SPEED]), 1.0)
    whole, _ = ran(ssd, start=0.5, state_every=0.1)
    part, _ = ran(ssd, start=0.5, start_from=f"{tmp_path / 'run_1'}@0.75")
    assert np.array_equal(part["b.theta_m"], whole["b.theta_m"][200:])


def test_clocks_of_an_fmu_tick_from_the_start_on(ran: Ran, root: Path, tmp_path: Path):
    clock = '<Clock name="beat" valueReference="20" causality="input" intervalVariability="constant" {}/>'
    said = clock.format('intervalDecimal="0.005" shiftDecimal="0.003"')
    drive = maker(root, tmp_path)('hasEventMode="true"', said, 'variability="discrete" clocks="20"')
    resources = {"r.fmu": RAMP.fmu(tmp_path / "r.fmu"), "e.fmu": drive}
    parts = [component("r", "r.fmu"), component("e", "e.fmu", bindings=values(f"kind={KINDS['samples']}"))]
    ssd = structure(system(parts, [connection("r.y", "e.omega_ref")]), 0.04)
    plain, _ = ran(ssd, resources, tick=0.001)
    later, _ = ran(ssd.replace("0.04", "2.04"), resources, tick=0.001, start=2.0)
    # the speed is the ramp at the last of the ticks, 3 ms behind the start and every 5 ms from there on
    assert np.unique(plain["e.omega_m"].round(9)).tolist() == [
        0.0,
        0.004,
        0.009,
        0.014,
        0.019,
        0.024,
        0.029,
        0.034,
        0.039,
    ]
    assert np.allclose(plain["e.omega_m"], later["e.omega_m"], atol=1e-9)


def test_without_a_stop_in_the_structure_the_longest_of_the_fmus_counts(ran: Ran, tmp_path: Path):
    resources = {
        name: Linear(**vars(RAMP) | {"experiment": text}).fmu(tmp_path / name)
        for name, text in (("x.fmu", 'startTime="1" stopTime="2"'), ("y.fmu", 'stopTime="3" stepSize="0.5"'))
    }
    ssd = structure(system([component("x", "x.fmu"), component("y", "y.fmu")]))
    run, facts = ran(ssd, resources)
    assert run.time("x").tolist() == [1.0, 1.5, 2.0, 2.5, 3.0]
    assert facts["stop_from"] == "the default experiment of y, the longest"
    assert "end        3 s by the default experiment of y, the longest" in system_result(facts).text
    # starts that differ are none
    resources["y.fmu"] = Linear(**vars(RAMP) | {"experiment": 'startTime="2" stepSize="1"'}).fmu(tmp_path / "y.fmu")
    assert ran(ssd, resources)[1]["start_s"] == 0.0


def test_a_component_may_make_longer_steps_by_option_or_annotation(ran: Ran):
    for whole, asked in (
        (system([A, B], [SPEED]), {"steps": {"b": 0.004}}),
        (system([A, noted(B, '<step stepSize="0.004"/>')], [SPEED]), {}),
        (system([A, noted(B, '<step stepSize="0.003"/>')], [SPEED]), {"steps": {"b": 0.004}}),
    ):
        run, facts = ran(structure(whole, 0.02), **asked)
        assert [one["step_s"] for one in facts["components"].values()] == [0.001, 0.004]
        # the FMU is told of 4 ms steps, and its result stands until the next one
        assert run["b.theta_m"].tolist() == pytest.approx([0.004 * (k // 4) for k in range(21)], abs=1e-12)
        assert "every 4 ms" in system_result(facts).text


@pytest.mark.parametrize(
    ("step", "told"),
    [
        (0.0015, "the step of b, 1.5 ms, is not a whole number of steps of 1 ms; set --step or --tick-ms"),
        (0.003, "the step of b, 3 ms, does not fit a run from 0 to 0.01 s; expected both to be whole multiples of it"),
    ],
)
def test_a_step_that_does_not_fit_is_refused(ran: Ran, step: float, told: str):
    with pytest.raises(InputRefused) as refused:
        ran(structure(system([A, B], [SPEED]), 0.01), steps={"b": step})
    assert told in str(refused.value)


def test_a_step_that_does_not_divide_the_run_is_rounded_by_lenient_with_a_note(ran: Ran):
    whole = structure(system([A, B], [SPEED]), 0.1)
    with pytest.raises(InputRefused, match=r"steps of 3 ms; set --stop-s or --tick-ms, or add --lenient"):
        ran(whole, tick=0.003)
    run, facts = ran(whole, tick=0.003, lenient=True)
    # 33.3 steps
    assert run.time("a").size == 34 and run.time("a")[-1] == pytest.approx(0.1, abs=1e-12)
    (told,) = facts["forgiven"]
    assert told.endswith("the step of 3 ms rounded to 3.0303 ms, so that the run is 33 steps")
    assert run["b.theta_m"][-1] == pytest.approx(0.1, abs=1e-9)
    # one that divides it is no offence
    assert ran(whole, tick=0.002, lenient=True)[1]["forgiven"] == []


def test_the_order_is_asked_for_or_annotated_or_that_of_the_file(ran: Ran):
    backward = system([B, A], [SPEED])
    note = '<ssc:Annotation type="twin.order"><order><component name="a"/></order></ssc:Annotation>'
    annotated = backward.replace("<ssd:Elements>", f"<ssd:Annotations>{note}</ssd:Annotations><ssd:Elements>")
    for whole, asked, order in (
        (backward, [], ["b", "a"]),
        (backward, ["a"], ["a", "b"]),
        (annotated, [], ["a", "b"]),
        (annotated, ["b"], ["b", "a"]),
    ):
        run, facts = ran(structure(whole, 0.01), order=asked)
        assert json.loads(run.metadata["system"]["order"]) == order == list(facts["components"])
        # the newest value is seen where a steps before b
        assert int(np.flatnonzero(run["b.omega_m"])[0]) == (1 if order == ["a", "b"] else 2)
        assert len(facts["late"]) == (order == ["b", "a"])
