"""The filter: its algebra, whether it knows how wrong it is, and that it is no worse than statics."""

import numpy as np
import pytest

from tests.studies.shadow.robots import (
    NOISE,
    Reference,
    Run,
    bounds,
    effective,
    experiment,
    ran,
    turns,
    variances,
    wandering,
)
from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.plant.dynamics import LONGEST_GAP
from twin.studies.replay.samples import RobotSamples, samples_of
from twin.studies.shadow.filter import Shadow
from twin.studies.shadow.filter_steps import UNKNOWN_DRIVE, Columns, FilterFeed, drive_model, filter_outputs, shadow_of
from twin.studies.shadow.layout import STATES

CHUNK = 50
"""RobotSamples from one look at the whole covariance to the next."""


def part_of(shadow: Shadow, samples: RobotSamples, first: int, count: int) -> Columns:
    """What the filter says at `count` of the samples, which are 2 ms apart."""
    part = slice(first, first + count)
    h = np.full(len(samples.t[part]), 2e-3)
    h[0] = 1e9 if first == 0 else 2e-3
    rows, status = play(shadow, samples.t[part], h, samples.u[part])
    assert status == 0
    return values_by_port(shadow.outputs, rows)


def test_it_is_the_filter_of_its_equations_written_anew():
    (samples, _), model = wandering(3, 5.0, 0.16), experiment(*NOISE)
    shadow, reference = shadow_of(model), Reference(model)
    part_of(shadow, samples, 0, 1)
    reference.x = shadow.memory["x"][0].copy()
    for k in range(1, len(samples.t)):
        y = part_of(shadow, samples, k, 1)
        reference.predict(2e-3, samples.u[k - 1, 6:9])
        NIS = reference.correct(samples.u[k, :6] * turns(model), variances(model))
        assert y["NIS"][0] == pytest.approx(NIS, rel=0.02, abs=0.02)
    P = shadow.memory["P"][0][:, :STATES]
    deviation, other = np.sqrt(np.diag(P)), np.sqrt(np.diag(reference.P))
    assert np.all(np.abs(shadow.memory["x"][0] - reference.x) < 0.05 * deviation)
    # a series and the middle of the motors' way against the exponential of the whole
    assert deviation == pytest.approx(other, rel=0.02)
    assert P / np.outer(deviation, deviation) == pytest.approx(reference.P / np.outer(other, other), abs=0.05)


@pytest.fixture(scope="module", params=[0.0, 5.0], ids=["air", "contact"])
def consistency(request):
    """NEES (runs, chunks), NIS (runs, n), and what is left of the motors' counts, squared, by their variances."""
    NEES, NIS, after = [], [], []
    model = experiment(*NOISE)
    for seed in range(12):
        (samples, x), shadow = wandering(seed, request.param), shadow_of(model)
        squares, told, left = [], [], []
        for k in range(0, len(samples.t), CHUNK):
            y = part_of(shadow, samples, k, CHUNK)
            error = shadow.memory["x"][0] - x[k + CHUNK - 1]
            squares.append(error @ np.linalg.solve(shadow.memory["P"][0][:, :STATES], error))
            told += y["NIS"].tolist()
            rest = samples.u[k : k + CHUNK, :3] * turns(model)[:3] - y["theta_m"]
            left += (rest**2 / variances(model)[:3]).sum(axis=1).tolist()
        # the beginning knows too little of the speeds
        NEES.append(squares[10:])
        NIS.append(told[10 * CHUNK :])
        after.append(left[10 * CHUNK :])
    return np.array(NEES), np.array(NIS), np.array(after)


def test_it_knows_how_wrong_its_state_is(consistency):
    NEES, _, _ = consistency
    low, high = bounds(STATES, effective(NEES))
    assert low < NEES.mean() < high


def test_it_knows_how_far_off_counts_will_be(consistency):
    _, NIS, _ = consistency
    low, high = bounds(6, effective(NIS))
    assert low < NIS.mean() < high


def test_what_is_left_after_a_count_is_taken_in_would_look_better_than_it_is(consistency):
    _, _, after = consistency
    low, _ = bounds(3, effective(after))
    assert after.mean() < low


@pytest.mark.parametrize("touching", [False, True], ids=["air", "contact"])
def test_beside_a_run_of_the_twin_it_is_never_surer_than_it_may_be(touching):
    run = ran("fig4_force_position", *NOISE)
    chosen = moving(run) & (run.touching == touching)
    NIS = run.y["NIS"][chosen]
    # the run has no drive that wanders, so that the filter expects a little more than there is
    assert 0.85 * 6 < NIS.mean() < bounds(6, effective(NIS[None]))[1]
    z = run.error[chosen] / run.y["deviation"][chosen]
    assert np.sqrt((z**2).mean(axis=0)).max() < 1.1


def moving(run: Run):
    """RobotSamples at which the robot moves, after the filter's start."""
    return (run.y["moves"] > 0) & (run.samples.t > 0.5)


EXPERIMENTS = ["fig4_force_position", "fig4_imperfect", "pressing", "tapping", "rolling", "pushing", "massage"]


@pytest.mark.parametrize("noise", [(), NOISE], ids=["rounding", "noise"])
@pytest.mark.parametrize(
    "name", [EXPERIMENTS[0], *(pytest.param(one, marks=pytest.mark.slow) for one in EXPERIMENTS[1:])]
)
def test_its_force_is_no_worse_than_that_of_statics(name, noise):
    # of fig4_imperfect the twin would have to know the zeros
    run = ran(name, *noise)
    chosen = moving(run) & run.touching
    error = np.sqrt((run.error[chosen][:, 12:] ** 2).sum(axis=1).mean())
    assert error <= np.sqrt((run.static[chosen] ** 2).sum(axis=1).mean())


def test_a_standing_robot_makes_it_no_surer_than_a_count():
    run = ran("fig4_force_position")
    u = np.repeat(run.samples.u[:1], 5000, axis=0)
    u[:, 6:9] = 0.0
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(np.asarray(np.arange(5000) * 2e-3), u))
    assert not y["moves"][1000:].any()
    # 50 in a tenth of a second would have been as many measurements
    assert y["deviation"][-1, 6] > 2 * np.pi / 4096 / np.sqrt(12) / 5
    assert np.all(np.isfinite(y["deviation"]))


def test_a_gap_starts_it_anew_and_a_short_one_does_not():
    run = ran("fig4_force_position")
    for lost, expected in ((20, 0), (200, 1)):
        keep = np.r_[0:3000, 3000 + lost : 4000]
        y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t[keep], run.samples.u[keep]))
        assert y["started"][1:].sum() == expected
        assert (lost * 2e-3 > LONGEST_GAP) == bool(expected)
        assert np.abs(y["p_B"][-1] - run.truth[3999, :3]).max() < 5e-5


def test_a_garbled_count_is_told_and_not_taken_in():
    run = ran("fig4_force_position")
    u = run.samples.u.copy()
    u[2500, 3] += 3000
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t, u))
    assert y["residual_l"][2500, 0] > 1.0
    assert y["NIS"][2500] > 1e4
    assert not y["started"][1:].any()
    assert np.abs(y["F_ee_B"][2501] - run.y["F_ee_B"][2501]).max() < 0.1


def test_a_count_that_did_not_come_is_not_missed():
    run = ran("fig4_force_position")
    u = run.samples.u.copy()
    u[1000:4000:3, 4] = np.nan
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t, u))
    assert np.isnan(y["residual_l"][1000, 1]) and not np.isnan(y["residual_l"][1001, 1])
    assert np.abs(y["p_B"][3999] - run.truth[3999, :3]).max() < 5e-5


def test_without_commands_it_follows_all_the_same():
    run = ran("fig4_force_position", *NOISE)
    u = run.samples.u.copy()
    u[:, 6:9] = np.nan
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t, u))
    chosen = moving(run)
    assert np.sqrt(((y["omega_m"] - run.truth[:, 9:12])[chosen] ** 2).mean()) < 0.3
    assert np.abs(y["F_ee_B"] - run.truth[:, 12:])[chosen].mean() < 0.2


def test_counts_that_do_not_come_are_refused_at_the_start_and_waited_for_later():
    run = ran("fig4_force_position")
    u = run.samples.u[:3000].copy()
    u[0, 3] = np.nan
    with pytest.raises(ComponentFailed, match="found no pose that fits the first counts"):
        filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t[:3000], u))
    keep = np.r_[:1000, 1200:3000]
    u[0, 3], u[1200:1300, 3] = run.samples.u[0, 3], np.nan
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t[keep], u[keep]))
    assert np.isnan(y["p_B"][1050]).all()
    assert np.abs(y["p_B"][-1] - run.truth[2999, :3]).max() < 5e-5


def test_counts_that_stay_somewhere_else_are_believed_after_a_tenth_of_a_second():
    run = ran("fig4_force_position")
    u = run.samples.u[:3000].copy()
    u[1000:2000, 3] += 3000
    y = filter_outputs(shadow_of(run.experiment), RobotSamples(run.samples.t[:3000], u))
    begun = np.flatnonzero(y["started"])[1:]
    assert len(begun) == 2 and 1050 <= begun[0] <= 1055 and 2050 <= begun[1] <= 2055
    assert np.abs(y["p_B"][-1] - run.truth[2999, :3]).max() < 5e-5


def test_the_same_samples_give_the_same_state_however_they_are_cut():
    run = ran("fig4_force_position", *NOISE)
    shadow = shadow_of(run.experiment)
    parts = [part_of(shadow, run.samples, k, 700)["F_ee_B"] for k in range(0, 2800, 700)]
    # the times of a run are rounded to nanoseconds, these periods are not
    assert np.abs(np.concatenate(parts) - run.y["F_ee_B"][:2800]).max() < 1e-9


def test_samples_one_by_one_give_the_bytes_of_all_at_once():
    run = ran("fig4_force_position", *NOISE)
    feed = FilterFeed(shadow_of(run.experiment))
    for k in range(300):
        for name, place in feed.inputs.items():
            place[:] = run.samples.only(name)[k]
        feed(run.samples.t[k])
        assert feed.outputs["F_ee_B"].tobytes() == run.y["F_ee_B"][k].tobytes()
    feed = FilterFeed(shadow_of(run.experiment))
    with pytest.raises(ComponentFailed, match=r"fits the first counts, t = 1\.000 s"):
        feed(1.0)


def test_an_unknown_drive_is_said_to_do_much_besides():
    known = drive_model(ran("fig4_force_position").experiment)
    assert known.lag == pytest.approx(0.02) and known.droop == pytest.approx(0.6)
    # its steps are not those of the equations
    assert drive_model(experiment("drive.substeps=2")) == UNKNOWN_DRIVE


def test_a_recording_without_counts_is_refused():
    class Empty:
        def fields(self):
            return {}

    with pytest.raises(InputRefused, match="needs the counts of all six encoders"):
        samples_of(Empty())  # type: ignore[arg-type]


def test_dry_friction_of_the_experiment_plays_no_role():
    run = ran("fig4_force_position")
    same = filter_outputs(shadow_of(experiment("plant.joint_friction_Nm=0.02")), run.samples)
    assert np.array_equal(same["F_ee_B"], run.y["F_ee_B"])
