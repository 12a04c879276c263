"""Outputs that are read within a step (FMI 3.0) against closed forms; what the FMU does is said in eventful.c."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.drive.commanded import stepped
from tests.drive.eventful import KINDS, READ, WITHIN, Maker
from tests.drive.test_component import TICK, run
from tests.drive.test_events import ALL
from twin.cli import drive_info
from twin.drive.component import FmuComponent
from twin.drive.within import Stray, Watch
from twin.errors import ComponentFailed
from twin.experiment.schema import Drive
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import DrivePlan, planned

BULGE = 1e-3
"""rad. What the angle bulges by in the middle of one step."""
SPEED = 0.5
"""rad/s."""


def plan_of(fmu: Path, kind: str, watched: bool = True, **more: float) -> DrivePlan:
    table = {"fmu": str(fmu), "parameters": {"kind": KINDS[kind], **more}}
    return replace(planned(Drive.model_validate(table)), watched=watched)


def made(plan: DrivePlan) -> FmuComponent:
    component = drive("drive_1", plan, TICK, 0.0, 0.0)
    assert isinstance(component, FmuComponent)
    return component


def stray(component: FmuComponent) -> Stray:
    """What the one output that can be read has done."""
    (one,) = component.strays
    assert one.name == "theta_m"
    return one


@pytest.mark.parametrize("abilities", ["", ALL])
def test_what_lies_beyond_both_ends_of_a_step_is_found_at_its_time(shaft: Maker, abilities: str):
    """Only what the solver has accepted counts, and it is read only when that is allowed."""
    fmu = shaft(f"{WITHIN} {abilities}", theta_m=READ)
    component = made(plan_of(fmu, "strays", period=0.013, stop=BULGE))
    run(component, SPEED, 0.0, 30)
    one = stray(component)
    # at the middle the bulge is whole, and half of the step's turn is still to come; rounding of angles
    assert one.beyond == pytest.approx(BULGE - 0.5 * SPEED * TICK, abs=1e-15)
    assert one.t == pytest.approx(0.0135, rel=1e-12)
    # at quarters of the step
    assert one.reads == 4.0


def test_it_strays_below_as_well(shaft: Maker):
    fmu = shaft(WITHIN, theta_m=READ)
    component = made(plan_of(fmu, "strays", period=0.013, stop=-BULGE))
    run(component, SPEED, 0.0, 30)
    assert stray(component).beyond == pytest.approx(BULGE - 0.5 * SPEED * TICK, abs=1e-15)


def test_inputs_are_set_on_their_line_before_outputs_are_read(shaft: Maker):
    fmu = shaft(WITHIN, omega_ref=READ, theta_m=READ)
    component = made(plan_of(fmu, "strays", period=0.013, stop=BULGE).with_lines())
    theta_m = stepped(component, lambda t: 2.0 * t, 30, inputs="linear")["theta_m"]
    one = stray(component)
    middle = 0.0135
    assert one.beyond == pytest.approx(BULGE - 0.5 * TICK * 2.0 * middle, abs=1e-15)
    assert one.t == pytest.approx(middle, rel=1e-12)
    assert theta_m[-1] == pytest.approx(0.03**2, abs=1e-15)


def test_a_peak_at_an_event_between_ticks_is_seen_where_the_step_goes_on_in_parts(shaft: Maker):
    """The fifth turn back lies at the middle of a step, so the recording misses most there."""
    fmu = shaft(f"{WITHIN} {ALL}", theta_m=READ)
    component = made(plan_of(fmu, "flips", period=3.3e-3))
    run(component, 1.0, 0.0, 20)
    one = stray(component)
    assert one.beyond == pytest.approx(0.5 * TICK, abs=1e-15)
    assert one.t == pytest.approx(5 * 3.3e-3, rel=1e-12)


def test_what_is_read_in_a_step_that_is_then_discarded_does_not_count(shaft: Maker):
    """There the angle is 1000 rad off."""
    fmu = shaft(f"{WITHIN} {ALL}", theta_m=READ)
    component = made(plan_of(fmu, "discards", period=0.3e-3))
    run(component, 1.0, 0.0, 20)
    # rounding of sums of parts of steps
    assert stray(component).beyond < 1e-15


def test_a_step_that_is_repeated_counts_once(shaft: Maker):
    fmu = shaft(WITHIN, theta_m=READ)
    component = made(plan_of(fmu, "strays", period=0.013, stop=BULGE))
    stepped(component, lambda t: SPEED, 30, iterations=3)
    assert component.instance.within is not None
    assert component.instance.within.rows["steps"].tolist() == [30]
    assert stray(component).beyond == pytest.approx(BULGE - 0.5 * SPEED * TICK, abs=1e-15)


def test_an_output_that_cannot_be_read_when_it_may_ends_the_run(shaft: Maker):
    fmu = shaft(WITHIN, theta_m=READ)
    component = made(plan_of(fmu, "shuts"))
    with pytest.raises(ComponentFailed) as failure:
        run(component, SPEED, 0.0, 30)
    assert "fmi3GetFloat64 within a step returned fmi3Error ('fmi3GetFloat64: not now')" in str(failure.value)
    assert "in the step from t = 0.009 s" in str(failure.value)


def test_an_output_that_cannot_be_read_before_the_first_step_is_a_failure_too(shaft: Maker):
    count = f'<Float64 name="count" valueReference="7" causality="output" {READ}/>'
    with pytest.raises(ComponentFailed, match=r"cannot be read before the first: .*fmi3GetFloat64"):
        made(plan_of(shaft(WITHIN, more=count), "strays"))


@pytest.mark.parametrize(
    ("abilities", "theta_m", "watched"),
    [("", READ, True), (WITHIN, "", True), (WITHIN, READ, False)],
)
def test_nothing_is_called_back_where_nothing_is_offered_or_wanted(
    shaft: Maker, abilities: str, theta_m: str, watched: bool
):
    component = made(plan_of(shaft(abilities, theta_m=theta_m), "strays", watched))
    assert component.strays == []
    assert not component.instance.fmu.intermediateUpdate
    assert component.instance.ramp["within"] == 0
    component.close()


def test_every_value_of_an_array_is_watched_by_its_own_name(shaft: Maker):
    component = made(plan_of(shaft(WITHIN, theta_m=READ), "strays"))
    theta_m = component.instance.description.variables["theta_m"]
    instance: Any = SimpleNamespace(read=lambda variables: [0.0] * 4, handle=0, address=lambda function: 0)
    watch = Watch(instance, [replace(theta_m, name="place", size=3), theta_m])
    assert [stray.name for stray in watch.strays] == ["place[1]", "place[2]", "place[3]", "theta_m"]


def test_only_an_input_that_travels_as_a_double_is_set_on_its_line(shaft: Maker):
    component = made(plan_of(shaft(WITHIN, omega_ref=READ, theta_m=READ), "strays").with_lines())
    omega_ref = component.instance.description.variables["omega_ref"]
    assert component.instance.ramps(omega_ref)
    assert not any(component.instance.ramps(replace(omega_ref, type=other)) for other in ("Float32", "Boolean"))
    component.close()


def test_info_tells_what_can_be_read_within_a_step(shaft: Maker):
    offered: dict[str, Any] = {"theta_m": READ}
    said = "  outputs    can be read within a step: theta_m\n"
    assert said in drive_info.text(planned(Drive.model_validate({"fmu": str(shaft(WITHIN, **offered))})))
    assert said not in drive_info.text(planned(Drive.model_validate({"fmu": str(shaft(**offered))})))
