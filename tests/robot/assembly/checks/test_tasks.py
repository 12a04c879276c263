"""Tasks that cannot or should not be carried out are refused before they run, with pose and limit."""

import re

import pytest

from tests.laws.runs import EXPERIMENTS, shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment

TASKS = ("massage", "pressing", "pushing", "rolling", "tapping")
BODIES = sorted(path.stem for path in (EXPERIMENTS / "bodies").glob("*.toml"))


def refusal(name, *overrides, body=None):
    with pytest.raises(InputRefused) as refused:
        load_experiment(EXPERIMENTS / f"{name}.toml", overrides, body=body)
    return str(refused.value)


def told(name, *overrides, body=None):
    """What is wrong, one sentence each."""
    text = refusal(name, *overrides, body=body)
    _, many, rest = text.partition(" mistakes:\n  ")
    return rest.split("\n  ") if many else [text.partition(".toml: ")[2]]


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("name", TASKS)
def test_every_shipped_task_can_be_carried_out_on_every_body_but_for_a_push_over_the_shoulder(name, body):
    if body == "shoulder" and name in ("massage", "pushing"):
        for sentence in told(name, body=body):
            assert re.search(r"friction cannot hold at \(.*\) mm: the surface slopes 1\d\.\d deg", sentence)
            assert sentence.endswith("friction 0.19 holds up to 10.8 deg")
    else:
        assert load_experiment(EXPERIMENTS / f"{name}.toml", body=body).contact.body == body


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        (
            "pressing",
            ["task.1.point_mm=[200, 0]", "monitor.enabled=false"],
            "p_B = (200.0, 0.0, -130.0) mm is out of reach: leg 1 would need l_b",
        ),
        (
            "rolling",
            ["task.1.radius_mm=120", "task.1.rate_Hz=0.01", "duration_s=600", "monitor.enabled=false"],
            "mm is out of reach: leg",
        ),
        (
            "pressing",
            ["approach.height_mm=-30"],
            "p_B = (0.0, 0.0, -50.0) mm is out of reach: leg 1",
        ),
        (
            "pressing",
            ["controller.model.l_b_mm=40", "monitor.enabled=false"],
            "is out of reach: leg 1 would need l_b",
        ),
        (
            "pressing",
            ["contact.stiffness_N_per_m=0"],
            "force_N = 8 cannot be built up: this body needs more than 100 mm of depth for it, "
            "[controller.force] limit_mm = 30",
        ),
        (
            "pressing",
            ["contact.stiffness_N_per_m=200"],
            "force_N = 8 cannot be built up: this body needs 40.0 mm of depth for it, [controller.force] limit_mm = 30",
        ),
        (
            "pressing",
            ["approach.floor_mm=-105"],
            "presses down to z = -107.4 mm on this body; [approach] floor_mm = -105 does not let it",
        ),
        (
            "pressing",
            ["contact.tilt_deg=20"],
            "friction cannot hold at (0.0, 0.0, -101.0) mm: the surface slopes 20.0 deg, friction 0.22 holds up to "
            "12.4 deg",
        ),
        (
            "pressing",
            ["approach.height_mm=-101"],
            "the surface is at z = -101.0 mm, [approach] height_mm = -101 is not above it",
        ),
        (
            "pressing",
            ["task.1.force_N=0.6"],
            "force_N = 0.6 is not above [controller.touch] contact_N = 0.6, the threshold of contact",
        ),
        (
            "pressing",
            ["contact.shape=sphere", "contact.radius_mm=20", "task.1.point_mm=[0, 25]"],
            "there is nothing to press on under (0.0, 25.0) mm: this body ends before",
        ),
        (
            "pushing",
            ["task.1.speed_mm_per_s=300", "monitor.enabled=false"],
            "joint 1 would have to turn at 8.5 rad/s (motor) at (0.0, 20.0, -101.0) mm; "
            "[controller] speed_limit_rad_per_s = 8",
        ),
        (
            "rolling",
            ["task.1.rate_Hz=12", "monitor.enabled=false"],
            "[controller] speed_limit_rad_per_s = 8",
        ),
        (
            "tapping",
            ["task.1.speed_mm_per_s=300", "monitor.enabled=false"],
            "[controller] speed_limit_rad_per_s = 8",
        ),
        (
            "tapping",
            ["task.1.period_s=0.4"],
            "period_s = 0.4: lift_mm = 8 down and up again takes 0.42 s",
        ),
        (
            "tapping",
            ["task.1.lift_mm=9.5"],
            "lift_mm = 9.5 goes above [approach] height_mm = -92, 9.0 mm over the surface",
        ),
        ("pressing", ["monitor.force_limit_N=8"], "force_N = 8: [monitor] force_limit_N = 8 would trip"),
        (
            "pushing",
            ["task.1.to_mm=[0, -41]"],
            "(0.0, -41.0) mm is 41.0 mm from the axis; [monitor] workspace_radius_mm = 40 would trip",
        ),
        ("pressing", ["monitor.z_min_mm=-105"], "presses down to z = -107.4 mm; [monitor] z_min_mm = -105 would trip"),
        ("pressing", ["monitor.z_max_mm=-95"], "[approach] height_mm = -92: [monitor] z_max_mm = -95 would trip"),
        (
            "pressing",
            ["monitor.penetration_limit_mm=6"],
            "force_N = 8 needs 6.4 mm of depth on this body; [monitor] penetration_limit_mm = 6 would trip",
        ),
        (
            "tapping",
            ["task.2.lift_mm=8", "monitor.speed_limit_mm_per_s=80"],
            "moves at 100 mm/s; [monitor] speed_limit_mm_per_s = 80 would trip",
        ),
        (
            "pressing",
            ["monitor.contact_time_limit_s=8.5"],
            "presses for 8.5 s without a pause; [monitor] contact_time_limit_s = 8.5 would trip",
        ),
        (
            "rolling",
            ["monitor.contact_time_limit_s=14"],
            "presses for 16.0 s without a pause; [monitor] contact_time_limit_s = 14 would trip",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_place_and_limit(name, overrides, said):
    (sentence,) = told(name, *overrides)
    assert sentence.startswith("[task ")
    assert said in sentence


@pytest.mark.parametrize(("body", "edge"), [("forearm", 41), ("upper_arm", 48)])
def test_a_limb_is_pressed_from_above_though_it_has_an_underside(body, edge):
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", body=body)
    assert experiment.contact.radius == pytest.approx(edge / 1e3)
    overrides = (f"task.1.point_mm=[{edge + 1}, 0]", "monitor.workspace_radius_mm=55")
    (sentence,) = told("pressing", *overrides, body=body)
    assert sentence == f"[task 1] there is nothing to press on under ({edge + 1}.0, 0.0) mm: this body ends before"


def test_a_duration_too_short_for_the_tasks_is_refused():
    # 9 mm down at 10 mm/s, 3.5 + 5 + 0.5 s, up at 40 mm/s, and three ramps
    assert told("pressing", "duration_s=10") == ["duration_s = 10: the tasks take about 10.4 s"]


@pytest.mark.parametrize("name", TASKS)
def test_the_estimated_time_is_enough_to_finish(name):
    """See test_every_task: all are done in time; here, that the shipped durations are not far longer than needed."""
    needed = float(told(name, "duration_s=1")[0].rpartition("about ")[2].removesuffix(" s"))
    assert needed <= shipped(name).duration_ticks * 1e-3 <= 2.0 * needed


def test_a_monitor_that_does_not_watch_refuses_nothing():
    assert shipped("pressing", "monitor.enabled=false", "monitor.force_limit_N=8").monitor is None


def test_everything_that_is_wrong_is_told_at_once():
    found = told(
        "massage",
        "task.1.hold_s=-1",
        "task.2.period_s=0.2",
        "task.3.point_mm=[200, 0]",
        "task.4.force_N=20",
        "monitor.z_min_mm=-102",
        "controller.force.trigger_N=0.6",
    )
    for said in (
        "[task 1] hold_s = -1: expected a number > 0",
        "[task 2] period_s = 0.2: lift_mm = 8 down and up again takes 0.26 s",
        "[task 2] presses down to z = -103.4 mm; [monitor] z_min_mm = -102 would trip",
        "[task 3] p_B = (205.0, 0.0, -130.0) mm is out of reach: leg 1",
        "[task 4] force_N = 20: [monitor] force_limit_N = 15 would trip",
        "[task 4] presses down to z = -117.0 mm; [monitor] z_min_mm = -102 would trip",
        "[controller.force] trigger_N: tasks have a force of their own and feel contact by [controller.touch]",
    ):
        assert sum(sentence.startswith(said) for sentence in found) == 1, said
