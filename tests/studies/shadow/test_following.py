"""The twin beside a robot: what it makes of samples, however they are cut; and a twin that does not follow."""

from dataclasses import replace

import numpy as np
import pytest

from tests.studies.replay.logs import EXPERIMENTS, FIG4, SCALE, ran
from tests.studies.shadow.robots import with_inputs
from twin.kernel.cosim.delay import values_by_port
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.log import MappedColumn
from twin.kernel.recording.logs.reader import recording_log
from twin.kernel.recording.reader import Recording
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import Belief
from twin.robot.plant.dynamics import LONGEST_GAP
from twin.studies.replay.model import RobotModel, model_of
from twin.studies.replay.parts import Rows
from twin.studies.replay.samples import RobotSamples, robot_samples
from twin.studies.shadow.alarm import CHANNELS, Tolerances, WatchState
from twin.studies.shadow.deviations import NOT_IDENTIFIED
from twin.studies.shadow.filter_steps import filter_outputs, shadow_of
from twin.studies.shadow.following import AlarmWatch, Twin, twin_of
from twin.studies.shadow.layout import OUTPUTS

EXPERIMENT = load_experiment(EXPERIMENTS / f"{FIG4}.toml", SCALE)
MODEL = model_of(EXPERIMENT)
N = 2500


def said(run: Recording, belief: Belief = MODEL.belief) -> RobotSamples:
    """What the robot of `run` says in its first 5 s, with the commands of its controller."""
    log = recording_log(run)
    robot = robot_samples(log, belief)
    speeds = log.vector("controller.omega_ref").values[:N]
    return RobotSamples(robot.t[:N], np.hstack([robot.counts[:N], speeds, np.full((N, 4), np.nan)]))


def part(samples: RobotSamples, a: int, b: int) -> RobotSamples:
    return samples.rows(slice(a, b))


def fed(twin: Twin, samples: RobotSamples, cuts: list[int]) -> Rows:
    """Rows of all `samples`, handed over in pieces."""
    pieces = [twin.feed(part(samples, a, b)) for a, b in zip([0, *cuts], [*cuts, N], strict=True)]
    return {topic: np.concatenate([piece[topic] for piece in pieces]) for topic in pieces[0]}


def test_the_estimate_is_that_of_the_run_bit_for_bit_and_the_law_is_the_robots():
    run = ran(FIG4)
    rows = fed(twin_of(EXPERIMENT, MODEL, "robot"), said(run), [])
    assert rows["estimator"][:, 6:9].tobytes() == run["estimator.p_B"][:N].tobytes()
    # the same law on the same counts: an error of rounding, in the length of a step
    assert np.max(np.abs(rows["residual/command"])) < 1e-9


def test_however_the_samples_are_cut_the_rows_are_the_same():
    samples = said(ran(FIG4))
    whole = fed(twin_of(EXPERIMENT, MODEL, "robot"), samples, [])
    cut = fed(twin_of(EXPERIMENT, MODEL, "robot"), samples, [1, 2, 7, 500, 501, 1900])
    for topic, rows in whole.items():
        # interpolated between the same two samples
        np.testing.assert_allclose(cut[topic], rows, rtol=0, atol=1e-9, err_msg=topic)


def test_the_state_is_that_of_the_filter_over_all_samples_and_a_command_holds_until_the_next():
    samples = said(ran(FIG4))
    commanded = samples.only("omega_ref").copy()
    commanded[1::2] = np.nan
    rows = fed(twin_of(EXPERIMENT, MODEL, "robot"), with_inputs(samples, omega_ref=commanded), [3, 1000])["shadow"]
    whole = filter_outputs(shadow_of(EXPERIMENT), with_inputs(samples, omega_ref=np.repeat(commanded[::2], 2, axis=0)))
    assert np.all(values_by_port(OUTPUTS, rows)["deviation"] >= whole.pop("deviation"))
    for name, values in values_by_port(OUTPUTS, rows).items():
        if name == "deviation":
            continue
        np.testing.assert_allclose(values.reshape(N, -1), whole[name].reshape(N, -1), rtol=0, atol=1e-9, err_msg=name)


def test_counts_that_jump_raise_the_alarm_and_those_of_a_healthy_robot_do_not():
    limits = {500.0: Tolerances(dict.fromkeys(CHANNELS, 1e9) | {"spread": 0.3}, dict.fromkeys(CHANNELS, 0.01))}
    jump = "fault=[{kind='encoder_bias', target='joint_encoder_1', onset_s=3.0, magnitude_deg=0.3}]"
    levels = []
    for run in (ran(FIG4), ran(FIG4, jump)):
        watched = AlarmWatch(limits, 1.0)
        rows = fed(twin_of(EXPERIMENT, MODEL, "robot", watched), said(run), [700])
        levels.append((len(watched.alarms), np.nanmax(rows["alarm"]) > 1.0))
    assert levels == [(0, False), (1, True)]
    assert watched.alarms[0].channel == "spread" and 3.0 < watched.alarms[0].t <= 5.0


def test_another_rate_has_its_own_tolerances_and_what_is_normal_is_learnt_anew():
    tight, wide = (
        Tolerances(dict.fromkeys(CHANNELS, 1e9) | {"spread": k}, dict.fromkeys(CHANNELS, 0.01)) for k in (0.3, 1e9)
    )
    samples, half = said(ran(FIG4)), N // 2
    for limits, state, known in (
        ({500.0: wide, 250.0: tight}, WatchState.COOLING_DOWN, True), ({500.0: wide}, WatchState.NOT_WATCHED, False),
    ):  # fmt: skip
        watched = AlarmWatch(limits, 1.0)
        twin = twin_of(EXPERIMENT, MODEL, "robot", watched)
        twin.feed(part(samples, 0, half))
        assert watched.changes == []
        watched.change_rate(2.5, 250.0)
        twin.feed(samples.rows(slice(half, None, 2)))
        assert watched.changes[0].state is state
        assert ("250" in watched.why_not) != known


def test_the_text_of_an_alarm_begins_with_its_caution():
    limits = {500.0: Tolerances(dict.fromkeys(CHANNELS, 1e9) | {"spread": 0.3}, dict.fromkeys(CHANNELS, 0.01))}
    jump = "fault=[{kind='encoder_bias', target='joint_encoder_1', onset_s=3.0, magnitude_deg=0.3}]"
    twin = twin_of(EXPERIMENT, MODEL, "robot", AlarmWatch(limits, 1.0, caution=NOT_IDENTIFIED))
    twin.feed(said(ran(FIG4, jump)))
    texts = [one.text for one in twin.happenings()]
    assert any(text.startswith(f"{NOT_IDENTIFIED}; robot and twin diverge") for text in texts), texts


def joint_residual(model: RobotModel, samples: RobotSamples, alive: bool = True) -> float:
    """rms over the joints, deg, from 1 s on."""
    twin = twin_of(EXPERIMENT, model, "robot")
    if not alive:
        frozen = twin.feed(part(samples, 0, 1))["plant"][0]
        rows = twin.feed(part(samples, 1, N))
        theta_l = frozen[6:9]
        r = theta_l - samples.only("count_l")[501:] * (2.0 * np.pi / model.belief.joint_counts)
    else:
        rows = twin.feed(samples)
        r = rows["residual/joints"][500:]
    return float(np.degrees(np.sqrt(np.mean(r**2))))


@pytest.mark.parametrize("what", ["springs", "swapped", "frozen"])
def test_a_twin_that_is_not_this_robot_is_seen(what: str):
    samples = said(ran(FIG4))
    alike = joint_residual(MODEL, samples)
    if what == "springs":
        wrong = replace(MODEL, plant=MODEL.plant._replace(k_s=0.8 * MODEL.plant.k_s))
        seen = joint_residual(wrong, samples)
    elif what == "swapped":
        order = [1, 0, 2]
        seen = joint_residual(MODEL, with_inputs(samples, count_l=samples.only("count_l")[:, order]))
    else:
        seen = joint_residual(MODEL, samples, alive=False)
    assert seen > 5.0 * alike


def test_after_a_long_gap_the_plant_model_starts_anew_and_says_so():
    samples = said(ran(FIG4))
    keep = (samples.t < 2.0) | (samples.t > 2.0 + 2.0 * LONGEST_GAP)
    samples = samples.rows(keep)
    twin = twin_of(EXPERIMENT, MODEL, "robot")
    rows = twin.feed(samples)
    assert [one.text for one in twin.happenings()] == ["the plant model restarts at rest"]
    assert twin.happenings() == []
    assert np.all(np.isfinite(rows["plant"]))


def test_a_plant_model_that_leaves_the_workspace_costs_no_more_than_itself():
    samples = said(ran(FIG4))
    twin = twin_of(EXPERIMENT, MODEL, "robot")
    twin.feed(part(samples, 0, 1000))
    broken = part(samples, 1000, 1100)
    twin.feed(with_inputs(broken, count_m=broken.only("count_m") + 30.0 * MODEL.belief.motor_counts))
    assert any("it restarts at rest" in one.text for one in twin.happenings())
    rows = twin.feed(part(samples, 1100, N))
    assert np.all(np.isfinite(rows["plant"][-500:])) and np.all(np.isfinite(rows["estimator"]))


@pytest.mark.parametrize(
    ("joint", "motor", "written"),
    [
        (180.0 / np.pi, 180.0 / np.pi, '"estimator.theta_l[0]" = "COLUMN[deg]"'),
        (1.0, 180.0 / np.pi, '"estimator.theta_m[0]" = "COLUMN[deg]"'),
        (1.0, -1.0, '"estimator.theta_m[2]" = "-COLUMN"'),
        (1.0, 3.0, "are their signs, units and zeros those of the experiment?"),
    ],
)
def test_angles_of_another_unit_or_sign_are_refused_with_what_to_write(joint: float, motor: float, written: str):
    samples = said(ran(FIG4))
    wrong = with_inputs(samples, count_m=motor * samples.only("count_m"), count_l=joint * samples.only("count_l"))
    columns = {f"estimator.theta_{side}[{leg}]": MappedColumn("COLUMN") for side in "ml" for leg in range(3)}
    with pytest.raises(InputRefused) as refused:
        twin_of(EXPERIMENT, MODEL, "robot", columns=columns).feed(wrong)
    assert written in str(refused.value)
