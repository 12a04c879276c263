"""What knowing the tissue is good for, with the drives' own FMUs: forces held closer, breath followed, taps on target.

The numbers asked for: rms force at 300 and at 5,000 N/m at most 0.7 of that with the one set that `twin tune` finds for
both, elsewhere at most 1.05; on a back that breathes at most half; taps within 10 % of their target, mean and median.
Where the tissue stiffens or softens under the head, the force is at most 1.5 times as far off as with one set.
"""

import itertools

import numpy as np
import pytest

from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import PhaseKind
from twin.robot.run.trace import run_in_memory

ONE_SET = (
    "monitor.enabled=false", "controller.position.kp_per_s=10.3", "controller.force.kp_mm_per_N=1.38",
    "controller.force.ki_mm_per_N_s=6.47",
)  # fmt: skip
POINTS = (300, 1.04, 29), (527, 1.28, 21.2), (924, 1.49, 15.6), (1620, 1.96, 13), (2850, 1.7, 7.79), (5000, 1.55, 5)
"""A schedule and its one set, found by twin tune pressing --schedule for the goals of the linear model alone."""
SCHEDULE = (
    *ONE_SET,
    "controller.tissue.tolerance=0.3",
    "controller.force.schedule=[{}]".format(
        ",".join("{{stiffness_N_per_m={},kp_mm_per_N={},ki_mm_per_N_s={}}}".format(*point) for point in POINTS)
    ),
)
BREATH = ("monitor.enabled=false", "controller.tissue.tolerance=0.3", "controller.breath.rate_per_min=15")
LEARNING = ("monitor.enabled=false", "controller.tissue.tolerance=0.3", "controller.touch.force_learning=0.5")
DRIVES = ("brushed_dc", "ideal_velocity", "modelica_dc", "pmsm_foc", "python_servo", "smart_servo", "stepper")
FAST = (*DRIVES, "torque_motor_fmi3")
"""Those with a bandwidth of 15 Hz or more in twin drive check."""
SOME = ("pmsm_foc", "stepper")


def pressed(task, settings, body="scale", drive=None):
    """(pressing force, its reference, phase, task) at each tick; the reference is NaN where the force loop is off."""
    experiment = load_experiment(f"experiments/{task}.toml", settings, body=body, drive=drive)
    only = ["plant.F_ee_B", *(f"controller.{name}" for name in ("triggered", "F_z_ref", "phase", "task"))]
    run = run_in_memory(experiment, only=only)
    reference = np.where(run.held("controller.triggered"), run.held("controller.F_z_ref"), np.nan)
    return -run["plant.F_ee_B"][:, 2], reference, run.held("controller.phase"), run.held("controller.task")


def rms(F, reference, where=True):
    off = (F - reference)[~np.isnan(reference) & where]
    return np.sqrt(np.mean(off**2))


def ratio(task, settings=(), **where):
    scheduled, one = (rms(*pressed(task, [*own, *settings], **where)[:2]) for own in (SCHEDULE, ONE_SET))
    return scheduled / one


@pytest.mark.parametrize("K", [300, 1225, 5000])
@pytest.mark.parametrize("drive", [None, "pmsm_foc"])
def test_with_a_schedule_the_force_is_held_closer_on_soft_and_stiff_than_with_one_set(K: int, drive):
    assert ratio("pressing", [f"contact.stiffness_N_per_m={K}"], drive=drive) <= 0.7


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "K"), [
    ("smart_servo", 5000),
    *(pytest.param(*at, marks=pytest.mark.endurance) for at in (("xl330", 300), ("mx106", 1225), ("mx106", 5000))),
])  # fmt: skip
def test_what_was_learnt_lasts_until_the_release_with_drives_that_swallow_the_dither(drive: str, K: int):
    # the hold teaches next to nothing there, and what little it does must not take the place of what the build-up did;
    # gears that stick make of one press what luck wants, so it is the median of nine that are as good as alike
    found = [
        ratio("pressing", [f"contact.stiffness_N_per_m={k}"], drive=drive) for k in np.geomspace(K / 1.04, K * 1.04, 9)
    ]
    assert np.median(found) <= 0.7


@pytest.mark.parametrize(("task", "body"), [
    ("rolling", "back"), ("pushing", "belly"),
    *(pytest.param("pressing", body, marks=pytest.mark.endurance) for body in ("calf", "forearm", "shoulder", "thigh")),
])  # fmt: skip
@pytest.mark.parametrize("settings", [
    (), pytest.param(("robot.motor_noise_deg=0.02", "robot.joint_noise_deg=0.01"), marks=pytest.mark.endurance),
    ('fault=[{kind="surface_jump",onset_s=6.0,magnitude_mm=3.0}]',),
])  # fmt: skip
def test_with_a_schedule_no_task_is_worse_on_any_body_with_noise_or_a_surface_that_jumps(task, body, settings):
    assert ratio(task, settings, body=body) <= 1.05


CHANGED = {"pressing": 7.0, "rolling": 8.0, "pushing": 6.0}
"""When (s) the stiffness begins to change: in the hold, in the first circles, on the first way."""
MONITORED = tuple(setting for setting in ONE_SET if not setting.startswith("monitor"))
ROUNDING = 0.025
"""Rms (N) of what rounding makes of the force that the robot believes; no loop of its own can tell less:
k_s eta N hypot(2 pi/4096, N 2 pi/16384)/sqrt(12) |J_z| = 0.0249 N at home (`Sensing.torque_rounding`)."""
STIFFNESS = (400, 3), (1600, 3), (400, 6), (800, 6), (400, 12), (1600, 0.3), (4800, 0.3), (4000, 0.1)
"""From which stiffness (N/m), to how many times as much."""
RAMPS = 0.0, 0.2, 0.5, 1.0, 2.0
CHANGING = "velocity_servo", "ideal_velocity", "pmsm_foc", "mx106", "python_servo", "torque_motor_fmi3"


def changing(settings, drive, task, K, factor, ramp):
    """(error of the force, from the change to the release or to the monitor's trip; whether it tripped)."""
    begins, ramp_s = CHANGED[task], f",ramp_s={ramp}" if ramp else ""
    fault = f'fault=[{{kind="stiffness_change",onset_s={begins},magnitude_factor={factor}{ramp_s}}}]'
    told = [*settings, f"contact.stiffness_N_per_m={K}", fault]
    run = run_in_memory(
        load_experiment(f"experiments/{task}.toml", told, drive=drive),
        only=["plant.F_ee_B", "controller.triggered", "controller.F_z_ref", "monitor.tripped"],
    )
    error = -run["plant.F_ee_B"][:, 2] - run.held("controller.F_z_ref")
    tripped = run.held("monitor.tripped")
    first = round(begins / run.tick)
    over = np.flatnonzero(~run.held("controller.triggered")[first:] | tripped[first:])
    end = first + int(over[0])
    return error[first:end], bool(tripped[end])


def refuse_more_than_one_set_makes(drive, task, K, factor, ramp):
    """The force error with the schedule against that with one set, as long as both press."""
    (one, _), (scheduled, _) = (
        changing(own, drive, task, K, factor, ramp) for own in (MONITORED, (*MONITORED, *SCHEDULE[len(ONE_SET) :]))
    )
    both = min(len(one), len(scheduled))
    one, scheduled = one[:both], scheduled[:both]
    assert np.sqrt(np.mean(scheduled**2)) <= 1.5 * np.sqrt(np.mean(one**2))
    # and a second after the change is over, where one set may be still to 0.002 N; a press is released by then
    begin = round((ramp + 1.0) / 1e-3)
    settled = slice(begin, begin + 2500)
    if task != "pressing" and both > settled.stop:
        off_one, off_scheduled = (np.sqrt(np.mean(error[settled] ** 2)) for error in (one, scheduled))
        assert off_scheduled <= max(1.5 * off_one, ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "task", "K", "factor", "ramp"), [
    ("velocity_servo", "rolling", 400, 12, 0.2), ("velocity_servo", "rolling", 400, 6, 2.0),
    ("velocity_servo", "pushing", 400, 12, 1.0), ("velocity_servo", "pushing", 4000, 0.1, 0.5),
    ("velocity_servo", "pressing", 400, 12, 2.0), ("pmsm_foc", "pushing", 400, 6, 0.2),
    ("mx106", "pushing", 1600, 3, 0.0), ("torque_motor_fmi3", "rolling", 1600, 0.3, 0.0),
    ("ideal_velocity", "pushing", 400, 6, 2.0),
])  # fmt: skip
def test_where_the_tissue_changes_under_the_head_the_force_is_not_worse_than_with_one_set(drive, task, K, factor, ramp):
    refuse_more_than_one_set_makes(drive, task, K, factor, ramp)


@pytest.mark.endurance
@pytest.mark.parametrize("drive", CHANGING)
@pytest.mark.parametrize("task", CHANGED)
def test_no_drive_task_or_change_of_the_tissue_makes_the_schedule_worse_than_one_set(drive, task):
    for (K, factor), ramp in itertools.product(STIFFNESS, RAMPS):
        refuse_more_than_one_set_makes(drive, task, K, factor, ramp)


def test_tissue_that_becomes_eight_times_as_stiff_in_an_instant_is_held_still_again():
    # too much for the monitor, 40 N; the swing of 4.9 Hz that gains for soft tissue make of it used to last, 0.4 N rms
    fault = 'fault=[{kind="stiffness_change",onset_s=10.0,magnitude_factor=8.0}]'
    F, reference, *_ = pressed("rolling", [*SCHEDULE, "contact.stiffness_N_per_m=400", fault])
    assert rms(F[11_000:13_500], reference[11_000:13_500]) < ROUNDING


@pytest.mark.parametrize("body", ["back", "belly"])
@pytest.mark.parametrize(("settings", "hold"), [(BREATH, True), ((*SCHEDULE, BREATH[-1]), False)])
def test_who_follows_the_breath_leaves_less_than_half_of_its_force(settings, hold: bool, body: str):
    # with the breath alone of the 5 s in which 8 N are held, the dither included; with the schedule of all of the press
    found = []
    for own in (settings, ("monitor.enabled=false",)):
        F, reference, phase, _ = pressed("pressing", own, body)
        found.append(rms(F, reference, phase == PhaseKind.HOLD if hold else True))
    assert found[0] <= 0.5 * found[1]


@pytest.mark.parametrize("body", ["back", "belly"])
@pytest.mark.parametrize(
    "drive", [*SOME, *(pytest.param(d, marks=pytest.mark.endurance) for d in FAST if d not in SOME)]
)
def test_taps_that_learn_from_their_force_meet_it_on_a_body_that_breathes(body: str, drive: str):
    F, _, phase, task = pressed("tapping", LEARNING, body, drive)
    begins = np.flatnonzero((phase == PhaseKind.TAP) & (np.roll(phase, 1) != PhaseKind.TAP))
    ends = np.append(begins[1:], len(F))
    for number in (1, 2):
        peaks = [F[a:b].max() for a, b in zip(begins, ends, strict=True) if task[a] == number]
        # of 3 N, mean and median of ten
        assert len(peaks) == 10 and np.mean(peaks) == pytest.approx(3.0, rel=0.1)
        assert np.median(peaks) == pytest.approx(3.0, rel=0.1)
        # single ones, as docs/control.md has them and why: 18 % on the belly, 40 % on the back
        assert peaks == pytest.approx([3.0] * 10, rel=0.2 if body == "belly" else 0.45)
