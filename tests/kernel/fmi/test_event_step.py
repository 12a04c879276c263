"""FMI 3.0: events, early return, clocks and inputs within a step against closed forms; and FMUs that play tricks."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.commanded import stepped
from tests.kernel.fmi.eventful import KINDS, Maker
from tests.kernel.fmi.test_component import TICK, made, run
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.cosim_step import CHANGING_CLOCK, COUNTDOWN_CLOCK, PERIODIC_CLOCK, update_discrete_states
from twin.kernel.hooks import HOOKS
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.schema import Drive
from twin.studies.qualify import drive_list as drive_info
from twin.studies.qualify.qualification import lifecycle_findings

EVENTS = 'hasEventMode="true"'
EARLY = 'mightReturnEarlyFromDoStep="true"'
VARIES = 'canHandleVariableCommunicationStepSize="true"'
ALL = f"{EVENTS} {EARLY} {VARIES}"
IN_CLOCK = '<Clock name="beat" valueReference="20" causality="input" {}/>'
OUT_CLOCK = '<Clock name="bang" valueReference="21" causality="output" intervalVariability="triggered"/>'
COUNT = '<Float64 name="status" valueReference="7" causality="output" variability="discrete" clocks="{}"/>'
CLOCKED = 'variability="discrete" clocks="20"'


def turned(fmu: Path, kind: str, speed: float = 1.0, ticks: int = 100, **parameters: Any) -> dict[str, np.ndarray]:
    """What the drive does at a constant command."""
    return run(made(fmu, parameters={"kind": KINDS[kind], **parameters}), speed, 0.0, ticks)


def triangle(t: np.ndarray, half: float) -> np.ndarray:
    """Rises from 0 at the rate 1 for `half`, falls for as long, and so on."""
    return half - np.abs(np.mod(t, 2.0 * half) - half)


def test_time_events_between_ticks_are_met_exactly(shaft: Maker):
    """The FMU refuses to be stepped over its next event, and its events lie at no ticks."""
    theta_m = turned(shaft(ALL), "flips", period=3.3e-3)["theta_m"]
    # sums of 130 rounded parts of steps
    assert np.allclose(theta_m, triangle(TICK * np.arange(101), 3.3e-3), rtol=0, atol=1e-15)


def test_state_events_end_a_step_early_and_the_rest_of_it_is_done(shaft: Maker):
    out = turned(shaft(ALL), "bounces", stop=3.3e-3)
    assert np.allclose(out["theta_m"], triangle(TICK * np.arange(101), 3.3e-3), rtol=0, atol=1e-15)
    assert set(out["omega_m"][1:]) == {1.0, -1.0}


def test_what_the_fmus_own_clock_updates_is_read_when_it_ticks_and_held(shaft: Maker):
    status = turned(shaft(ALL, clocks=OUT_CLOCK, more=COUNT.format(21)), "bounces", stop=3.3e-3)["status"]
    assert status.tolist() == [np.floor(k / 3.3) for k in range(101)]


@pytest.mark.parametrize(
    ("rhythm", "first", "every"),
    [
        ('intervalVariability="constant" intervalDecimal="0.005"', 0, 5),
        ('intervalVariability="constant" intervalDecimal="0.005" shiftDecimal="0.003"', 3, 5),
        ('intervalVariability="constant" intervalCounter="2" shiftCounter="1" resolution="1000"', 1, 2),
        ('intervalVariability="fixed" intervalDecimal="0.004"', 0, 4),
        ('intervalVariability="tunable"', 2, 7),
        ('intervalVariability="changing"', 7, 7),
        ('intervalVariability="countdown"', 7, 7),
        ('intervalVariability="triggered"', 0, 1),
    ],
)
def test_an_input_clock_ticks_where_it_has_to(shaft: Maker, rhythm: str, first: int, every: int):
    """The command rises by 1 rad/s in each tick, and the shaft turns as it was when the clock ticked last."""
    fmu = shaft(ALL, clocks=IN_CLOCK.format(rhythm), omega_ref=CLOCKED, more=COUNT.format(20))
    table = {"fmu": str(fmu), "parameters": {"kind": KINDS["samples"], "period": 7e-3}}
    component = drive("drive_1", plan_drive(Drive.model_validate(table)), TICK, 0.0, 0.0)
    out = stepped(component, lambda t: round(t / TICK), 50)
    k = np.arange(50)
    held = np.where(k >= first, first + (k - first) // every * every, 0)
    assert out["omega_m"][1:].tolist() == held.tolist()
    # sums of 50 products
    assert out["theta_m"][1:] == pytest.approx(np.cumsum(held) * TICK, rel=1e-14)
    assert out["status"][1:].tolist() == np.maximum((k - first) // every, 0).tolist()


@pytest.mark.parametrize("rhythm", ["changing", "countdown", 'constant" intervalDecimal="0.001'])
def test_an_input_clock_may_tick_in_every_step(shaft: Maker, rhythm: str):
    fmu = shaft(ALL, clocks=IN_CLOCK.format(f'intervalVariability="{rhythm}"'), omega_ref=CLOCKED)
    component = made(fmu, parameters={"kind": KINDS["samples"], "period": TICK})
    assert stepped(component, lambda t: round(t / TICK), 20)["omega_m"][1:].tolist() == list(range(20))


@pytest.mark.parametrize(
    ("rhythm", "kind"), [("changing", CHANGING_CLOCK), ("countdown", COUNTDOWN_CLOCK), ("triggered", PERIODIC_CLOCK)]
)
def test_a_clock_is_asked_for_its_next_tick_as_its_kind_wants_it(shaft: Maker, rhythm: str, kind: int):
    """One that counts down after every event, one that changes after its ticks, others never."""
    fmu = shaft(ALL, clocks=IN_CLOCK.format(f'intervalVariability="{rhythm}"'), omega_ref=CLOCKED)
    component = made(fmu, parameters={"kind": KINDS["samples"], "period": TICK})
    assert isinstance(component, FmuComponent)
    (clock,) = component.instance.clocks
    assert clock["kind"] == kind
    component.close()


def test_a_countdown_that_says_unchanged_in_an_event_of_another_kind_goes_on_to_count(shaft: Maker):
    # bounces lie at no ticks: counted from one of them anew, the clock would be due between two
    fmu = shaft(ALL, clocks=IN_CLOCK.format('intervalVariability="countdown"'))
    theta_m = turned(fmu, "bounces", stop=3.3e-3, period=7e-3)["theta_m"]
    assert np.allclose(theta_m, triangle(TICK * np.arange(101), 3.3e-3), rtol=0, atol=1e-15)


def test_a_discrete_input_is_set_in_an_event_and_only_when_it_changes(shaft: Maker):
    """The FMU refuses to have it set anywhere else."""
    fmu = shaft(ALL, omega_ref='variability="discrete"')
    table = {"fmu": str(fmu), "parameters": {"kind": KINDS["switches"]}}
    component = drive("drive_1", plan_drive(Drive.model_validate(table)), TICK, 0.0, 0.0)
    omega_m = stepped(component, lambda t: float(t > 0.0095), 30)["omega_m"]
    assert omega_m[1:].tolist() == [float(k >= 10) for k in range(30)]


def test_a_discarded_step_is_made_in_shorter_ones(shaft: Maker):
    theta_m = turned(shaft(VARIES + " " + EARLY), "discards", period=0.3e-3)["theta_m"]
    # sums of 400 rounded parts of steps
    assert theta_m == pytest.approx(TICK * np.arange(101), rel=1e-13)


@pytest.mark.parametrize("smooth", [True, False])
def test_an_input_that_rises_is_taken_as_a_line_within_the_step(shaft: Maker, smooth: bool):
    """Without, it is taken at the middle of the step, and the speed at its end comes out half a step late."""
    ability = f'{VARIES} {EARLY} providesIntermediateUpdate="true"'
    fmu = shaft(ability, omega_ref='intermediateUpdate="true"' if smooth else "")
    plan = replace(plan_drive(Drive.model_validate({"fmu": str(fmu)})), ramped=True)
    component = drive("drive_1", plan, TICK, 0.0, 0.0)
    out = stepped(component, lambda t: 2.0 * t, 100, inputs="linear")
    t = TICK * np.arange(101)
    late = 0.0 if smooth else 0.5 * TICK
    # rounding of 100 sums
    assert out["omega_m"][1:] == pytest.approx(2.0 * (t[1:] - late), rel=1e-12)
    assert out["theta_m"] == pytest.approx(t**2, abs=1e-15)


def test_structure_sizes_arrays_and_text_and_files_reach_the_fmu(shaft: Maker, tmp_path: Path):
    more = """
    <UInt64 name="n" valueReference="30" causality="structuralParameter" variability="fixed" start="2" max="8"/>
    <Float64 name="table" valueReference="31" causality="parameter" variability="fixed" start="0 0">
      <Dimension valueReference="30"/></Float64>
    <String name="text" valueReference="32" causality="parameter" variability="fixed"><Start value=""/></String>
    <Binary name="blob" valueReference="33" causality="parameter" variability="fixed"><Start value="00"/></Binary>
    <Float64 name="status" valueReference="34" causality="output"/>"""
    (tmp_path / "curve.bin").write_bytes(b"\x07\x00\x00")
    fmu = shaft(ALL, more=more)
    told: dict[str, Any] = {
        "n": 4.0,
        "table": [1.0, 2.0, 3.0, 4.0],
        "text": "five5",
        "blob": f"file:{tmp_path / 'curve.bin'}",
    }
    assert turned(fmu, "follows", **told)["status"][-1] == 10.0 + 500.0 + 30_007.0
    assert turned(fmu, "follows", n=3.0, table=2.0)["status"][-1] == 6.0

    def refusal(**told: Any) -> str:
        with pytest.raises(InputRefused) as refused:
            made(fmu, parameters=told)
        return str(refused.value)

    assert "table: 4 values; expected 2, or one for all of them" in refusal(table=[1.0, 2.0, 3.0, 4.0])
    assert "n = 9: expected" in refusal(n=9.0)
    assert "'table' would have 1e+09 values; expected 1 .. 1000000" in refusal(n=1e9)
    assert "n = 2.5: expected a whole number" in refusal(n=2.5)
    assert "text = 2.0: expected text" in refusal(text=2.0)
    assert "table = 'x': expected a number" in refusal(table="x")
    assert "no such file" in refusal(blob=f"file:{tmp_path / 'none'}")
    assert "no such file" in refusal(text=f"file:{tmp_path / 'none'}")


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("stuck", "fmi3DoStep stays at t = 0.01 s: more than 100 events or early returns there"),
        ("no_time", "fmi3DoStep reports that it stepped until t = nan s, which lies outside of this step"),
        ("before", "fmi3DoStep reports that it stepped until t = 0.009 s, which lies outside of this step"),
        ("beyond", "fmi3DoStep reports that it stepped until t = 0.012 s, which lies outside of this step"),
        ("past", "fmi3UpdateDiscreteStates plans its next event for t = 0.01 s, which has passed or is no time"),
        ("no_event_time", "fmi3UpdateDiscreteStates plans its next event for t = nan s, which has passed or is no"),
        ("crumbles", "fmi3DoStep takes more than 10000 parts for this step, and is at t = 0.01001 s"),
        ("refuses", "fmi3DoStep returned fmi3Discard and stays at t = 0.01 s, however short its steps"),
        ("locked_out", "fmi3EnterEventMode returned fmi3Error"),
        ("locked_in", "fmi3EnterStepMode returned fmi3Error"),
        ("ends", "fmi3DoStep asked to terminate the simulation"),
        ("endless_later", "fmi3UpdateDiscreteStates wants to be called for ever: more than 1000 times in one event"),
    ],
)
def test_an_fmu_that_never_comes_to_the_end_of_a_step_ends_the_run_with_a_sentence(shaft: Maker, kind: str, said: str):
    with pytest.raises(ComponentFailed) as failure:
        turned(shaft(ALL), kind)
    assert said in str(failure.value)
    assert "in the step from t = 0.01 s, tick 10." in str(failure.value)


def test_an_event_that_never_ends_while_it_is_initialised_is_refused(shaft: Maker):
    with pytest.raises(InputRefused, match="wants to be called for ever"):
        turned(shaft(ALL), "endless")


@pytest.mark.parametrize("abilities", ["", EVENTS])
def test_an_early_return_that_was_not_announced_is_no_result(shaft: Maker, abilities: str):
    with pytest.raises(ComponentFailed, match="returned early, which its description does not permit"):
        turned(shaft(abilities), "stuck")


@pytest.mark.parametrize(
    ("rhythm", "period", "said"),
    [
        (
            'intervalVariability="constant" intervalDecimal="0.0025"',
            1.0,
            "interval or shift of 2.5 ms; the drive's step",
        ),
        ('intervalVariability="constant" intervalDecimal="0"', 1.0, "interval or shift of 0 ms"),
        ('intervalVariability="constant" intervalDecimal="NaN"', 1.0, "interval or shift of nan ms"),
        ('intervalVariability="constant" intervalCounter="1" resolution="0"', 1.0, "interval or shift of nan ms"),
        ('intervalVariability="constant" intervalDecimal="0.005" shiftDecimal="-0.001"', 1.0, "shift of -1 ms"),
        ('intervalVariability="changing"', 0.0005, "interval or shift of 0.5 ms"),
        ('intervalVariability="countdown"', 0.0, "interval or shift of 0 ms"),
    ],
)
def test_a_clock_that_does_not_tick_in_whole_steps_is_refused(shaft: Maker, rhythm: str, period: float, said: str):
    fmu = shaft(ALL, clocks=IN_CLOCK.format(rhythm), omega_ref=CLOCKED)
    with pytest.raises(InputRefused) as refused:
        turned(fmu, "samples", period=period)
    assert said in str(refused.value)


def test_clocks_that_fit_finer_steps_are_served_in_substeps(shaft: Maker):
    rhythm = 'intervalVariability="constant" intervalDecimal="0.0025"'
    fmu = shaft(ALL, clocks=IN_CLOCK.format(rhythm), omega_ref=CLOCKED)
    out = run(made(fmu, parameters={"kind": KINDS["samples"]}, substeps=2), 1.0, 0.0, 100)
    # rounding of 200 sums
    assert out["theta_m"] == pytest.approx(TICK * np.arange(101), rel=1e-13)


def test_repeated_steps_bring_events_and_clocks_back_too(shaft: Maker):
    """With held inputs a step that is made twice comes to the same."""
    for kind, more in (("flips", {"period": 3.3e-3}), ("bounces", {"stop": 3.3e-3})):
        once, twice = (
            stepped(made(shaft(ALL), parameters={"kind": KINDS[kind], **more}), lambda t: 1.0, 100, iterations=n)
            for n in (1, 2)
        )
        assert np.array_equal(once["theta_m"], twice["theta_m"])


@pytest.mark.parametrize(("kind", "more"), [("flips", {"period": 3.3e-3}), ("bounces", {"stop": 3.3e-3})])
def test_its_reset_and_its_state_are_examined_with_its_events(shaft: Maker, kind: str, more: dict[str, float]):
    """Going back in time brings back what is planned, too."""
    plan = plan_drive(Drive.model_validate({"fmu": str(shaft(ALL)), "parameters": {"kind": KINDS[kind], **more}}))
    # they write no state down
    expected = [("reset", "ok"), ("state", "ok"), ("written", "note")]
    assert [(f.name, f.verdict) for f in lifecycle_findings(plan, apart=False)] == expected  # type: ignore[union-attr]


def test_a_clocked_drive_qualifies_on_the_bench(shaft: Maker):
    rhythm = IN_CLOCK.format('intervalVariability="constant" intervalDecimal="0.002"')
    table = {"fmu": str(shaft(ALL, clocks=rhythm, omega_ref=CLOCKED)), "parameters": {"kind": KINDS["samples"]}}
    found = lifecycle_findings(plan_drive(Drive.model_validate(table)), apart=False)
    assert {f.name: f.verdict for f in found} == {"reset": "ok", "state": "ok", "written": "note"}  # type: ignore[union-attr]


def test_info_says_how_it_is_stepped(shaft: Maker):
    clocks = IN_CLOCK.format('intervalVariability="constant" intervalDecimal="0.005" shiftDecimal="0.003"') + OUT_CLOCK
    fmu = shaft(f'{EVENTS} {EARLY} fixedInternalStepSize="0.002"', clocks=clocks, omega_ref=CLOCKED)
    told = drive_info.drive_text(plan_drive(Drive.model_validate({"fmu": str(fmu)})))
    assert "  steps      steps of one size only; it prefers 2 ms\n" in told
    assert "  events     event mode, may return early\n" in told
    assert "  clock      beat, every 5 ms from 3 ms on\n" in told
    assert "  clock      bang, ticked by the FMU\n" in told


@pytest.mark.parametrize(
    ("fixed", "table", "said"),
    [
        ("0.002", {}, "its step here is 1 ms: choose tick_ms = 2"),
        ("0.0005", {"substeps": 3}, "its step here is 0.333333 ms: choose substeps = 2"),
        ("0.0005", {"substeps": 2}, ""),
        ("0.0005", {}, ""),
    ],
)
def test_a_step_that_does_not_fit_a_fixed_one_inside_is_refused(
    shaft: Maker, fixed: str, table: dict[str, Any], said: str
):
    fmu = shaft(f'fixedInternalStepSize="{fixed}"')
    if not said:
        made(fmu, **table).close()
        return
    with pytest.raises(InputRefused) as refused:
        made(fmu, **table)
    assert said in str(refused.value)
    made(shaft(f'{VARIES} fixedInternalStepSize="{fixed}"'), **table).close()


def test_a_file_is_found_from_where_it_is_named(shaft: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "curves").mkdir()
    (tmp_path / "curves" / "curve.bin").write_bytes(b"\x07")
    more = '<Binary name="blob" valueReference="33" causality="parameter" variability="fixed"/>'
    fmu = shaft(ALL, more=more)
    said = f'fmu = "{fmu}"\n[parameters]\nblob = "file:curves/curve.bin"\n'
    (tmp_path / "mapping.toml").write_text(said)
    monkeypatch.chdir("/")
    found = plan_drive(load_drive(str(tmp_path / "mapping.toml"), Path("/")))
    assert [value for _, value in found.settings[""]] == [[b"\x07"]]
    digest = hashlib.sha256(b"\x07").hexdigest()
    assert f"blob = 1 bytes, sha256 {digest}" in drive_info.drive_text(found)


def test_nothing_is_compiled_while_a_call_is_announced(shaft: Maker, monkeypatch: pytest.MonkeyPatch):
    """A supervisor would charge the FMU with it."""
    announced: list[str] = [""]
    monkeypatch.setattr(HOOKS, "fmi_call", [lambda file, instance, function: announced.append(function)])
    compiled, during = update_discrete_states.native, []

    class Later:
        """`update_discrete_states`, not compiled yet."""

        @property
        def c_function(self) -> Any:
            during.append(announced[-1])
            return compiled.c_function

    monkeypatch.setattr(update_discrete_states, "native", Later())
    turned(shaft(ALL), "flips")
    assert during == [""] and "fmi3UpdateDiscreteStates" in announced
