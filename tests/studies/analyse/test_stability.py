import json
from dataclasses import replace

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import operating_points
from twin.studies.analyse.stability import MAP_FACTORS, MAP_STIFFNESSES, Stability, judge_point, stability
from twin.studies.analyse.text import analysis_result


@pytest.fixture(scope="module")
def fig4() -> Stability:
    return stability(shipped())


@pytest.fixture(scope="module")
def too_much() -> Stability:
    return stability(shipped("fig4_force_position", "controller.position.kp_per_s=20"))


@pytest.mark.slow
def test_fig4_is_stable_and_free_air_limits_its_position_gains(fig4):
    assert fig4.stable
    assert not fig4.critical("position").linear.point.in_contact
    assert fig4.critical("force").linear.point.in_contact


@pytest.mark.slow
def test_an_unstable_point_has_no_margins_and_a_limit_below_one(too_much):
    unstable = [point for point in too_much.points if not point.stable]
    assert unstable and not too_much.stable
    for point in unstable:
        assert point.margins == {} and point.disks == {} and point.sensitivity is None
        assert 0.0 < point.limits["position"] < 1.0
        assert point.poles[0].zeta < 0.0


@pytest.mark.slow
def test_a_stable_point_has_disks_at_its_laws_at_its_motors_and_smaller_ones_at_both(fig4):
    for point in fig4.points:
        laws, motors, both = (point.disks[where].alpha for where in ("laws", "motors", "both"))
        # laws and motors follow one another in a loop, so that both at once have less room
        assert 0.0 < both < 0.9 * min(laws, motors)
        assert max(laws, motors) <= 2.0
    # as docs/loops.md has them: to the digits told
    pressing = fig4.points[2]
    told = {where: f"{disk.alpha:.2f}" for where, disk in pressing.disks.items()}
    assert told == {"laws": "0.89", "motors": "1.71", "both": "0.56"}
    assert f"{pressing.disks['laws'].gain:.3g}" in analysis_result(fig4).text


@pytest.mark.slow
def test_the_limit_is_a_gain_not_a_factor(fig4, too_much):
    one, other = (done.critical("position").limits["position"] for done in (fig4, too_much))
    # both are bisected to 1e-4
    assert 1.5 * one == pytest.approx(20.0 * other, rel=1e-3)


@pytest.mark.slow
def test_waiting_for_the_computer_costs_gain(fig4):
    experiment = shipped("fig4_force_position", "controller.delay_ticks=20")
    points, _ = operating_points(experiment)
    late = judge_point(Linearisation(experiment, points).linear_point(points[2]))
    assert late.limits["force"] < 0.6 * fig4.points[2].limits["force"]
    # in a loop it is the same where it waits
    encoders = shipped("fig4_force_position", "plant.encoder_latency_ms=20")
    assert judge_point(Linearisation(encoders, points).linear_point(points[2])).limits == late.limits


def test_dry_friction_is_told_to_be_left_out(fig4):
    rubbing = replace(fig4, experiment=shipped("fig4_force_position", "plant.joint_friction_Nm=0.002"))
    said = "dry friction (joint_friction_Nm, spring_hysteresis) is not in the linear model"
    assert said in " ".join(analysis_result(rubbing).text.split())
    assert "dry friction" not in analysis_result(fig4).text


def test_the_map_meets_the_limit_at_the_experiment_s_own_stiffness(fig4):
    for chart in fig4.maps:
        column = np.argmin(np.abs(np.log(chart.stiffness / 1250.0)))
        stable = MAP_FACTORS[np.flatnonzero(chart.zeta[:, column] < 0.0)[0] - 1]
        limit = next(p for p in fig4.points if p.linear is chart.at).limits[chart.law]
        # half a step of either grid on a limit that varies with the root of the stiffness
        assert stable == pytest.approx(limit, rel=0.25)
        assert chart.zeta.shape == (len(MAP_FACTORS), len(MAP_STIFFNESSES))


def test_facts_are_json_without_nan(fig4, too_much):
    for done in (fig4, too_much):
        assert json.loads(json.dumps(done.to_dict(), allow_nan=False))["stable"] is done.stable


def test_a_monitor_that_passes_commands_on_late_is_refused():
    with pytest.raises(InputRefused, match="passes the controller's commands on late"):
        stability(shipped("massage", "controller.delay_ticks=1", "monitor.period_ms=2"))


def test_a_delay_behind_the_monitor_is_as_long_whatever_the_monitor_samples():
    experiment = shipped("massage", "controller.bus_delay_ticks=1", "monitor.period_ms=2")
    assert Linearisation(experiment, operating_points(experiment)[0]).stepping.delay == 1


def test_the_text_says_the_verdict_first_in_80_columns(fig4, too_much):
    for done, verdict in ((fig4, "STABLE at all 5"), (too_much, "UNSTABLE at 2 of 5")):
        lines = analysis_result(done).text.splitlines()
        assert lines[0] == f"fig4_force_position  {verdict} operating points"
        assert max(map(len, lines)) <= 80
