import numpy as np
import pytest

from tests.robot.faults.robot import COUNTS, PERIOD, TICK, Run, run
from twin.robot.experiment.fault import Fault

LAST = 4000
ONSET, END = 1000, 3000
DEG = np.pi / 180.0
MOTOR, JOINT = ("motor_encoder_2", 1, COUNTS[0]), ("joint_encoder_3", 5, COUNTS[1])
"""Target, column of what the estimator reads, counts per turn."""
BOTH = [MOTOR, JOINT]


def broken(kind: str, target: str, magnitude: float = 0.0, **options: float) -> Run:
    return run(Fault(kind, target, ONSET, END, magnitude, **options), last_tick=LAST)  # type: ignore[arg-type]


def samples(done: Run, column: int) -> tuple[np.ndarray, np.ndarray]:
    """(clean, read) counts of one channel at the samples in the window."""
    clean = np.hstack([done["encoder.count_m"], done["encoder.count_l"]])[ONSET:END:PERIOD, column]
    return clean, done["estimator.read"][ONSET:END:PERIOD, column]


@pytest.mark.parametrize(("target", "column", "turn"), BOTH)
@pytest.mark.parametrize("degrees", [0.5, -2.0])
def test_a_bias_is_the_stated_angle_of_the_encoders_own_shaft(target, column, turn, degrees):
    clean, read = samples(broken("encoder_bias", target, degrees * DEG), column)
    # whole counts: half of one
    np.testing.assert_allclose((read - clean) * 360.0 / turn, degrees, atol=180.0 / turn)
    np.testing.assert_array_equal(read, np.round(read))


@pytest.mark.parametrize(("target", "column", "turn"), BOTH)
def test_a_drift_grows_at_the_stated_speed_from_nothing_at_the_onset(target, column, turn):
    clean, read = samples(broken("encoder_drift", target, 3.0 * DEG), column)
    t = np.arange(0, END - ONSET, PERIOD) * TICK
    # whole counts: half of one
    np.testing.assert_allclose((read - clean) * 360.0 / turn, 3.0 * t, atol=180.0 / turn)


@pytest.mark.parametrize(("target", "column", "turn"), BOTH)
def test_coarser_steps_are_multiples_of_the_step_and_the_nearest(target, column, turn):
    step = round(2.0 / 360.0 * turn)
    clean, read = samples(broken("encoder_quantisation", target, 2.0 * DEG), column)
    np.testing.assert_array_equal(read % step, 0.0)
    assert np.abs(read - clean).max() <= step / 2


@pytest.mark.parametrize(("target", "column", "_"), BOTH)
def test_a_stuck_encoder_repeats_its_last_count_before_the_onset(target, column, _):
    done = broken("encoder_stuck", target)
    before = done["estimator.read"][ONSET - PERIOD, column]
    np.testing.assert_array_equal(samples(done, column)[1], before)


def test_an_encoder_stuck_from_the_start_repeats_its_first_count():
    done = run(Fault("encoder_stuck", "joint_encoder_1", 0), last_tick=50)
    np.testing.assert_array_equal(done["estimator.read"][:, 3], 900.0)


@pytest.mark.parametrize(("target", "column", "_"), BOTH)
def test_a_flipped_encoder_has_the_other_sign(target, column, _):
    clean, read = samples(broken("encoder_flip", target), column)
    np.testing.assert_array_equal(read, -clean)


@pytest.mark.parametrize(("target", "pair"), [("motor_encoder_1", (0, 1)), ("joint_encoder_3", (5, 3))])
def test_swapped_channels_exchange_their_counts(target, pair):
    done = broken("encoder_swap", target)
    for column, other in (pair, pair[::-1]):
        np.testing.assert_array_equal(samples(done, column)[1], samples(done, other)[0])


@pytest.mark.parametrize(("target", "column", "_"), BOTH)
def test_other_channels_stay_as_they_are(target, column, _):
    done = broken("encoder_bias", target, 1.0 * DEG)
    for other in set(range(6)) - {column}:
        clean, read = samples(done, other)
        np.testing.assert_array_equal(read, clean)


SAMPLES = (END - ONSET) // PERIOD


def expected_lost(share: float) -> float:
    """Five standard deviations of the number of lost samples, of `SAMPLES`; the seed is fixed."""
    return 5.0 * np.sqrt(SAMPLES * share * (1.0 - share))


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
@pytest.mark.parametrize(("kind", "lost_reads"), [("encoder_dropout_zero", 0.0), ("encoder_dropout_nan", np.nan)])
def test_the_stated_share_of_samples_is_lost(kind, lost_reads, share):
    clean, read = samples(broken(kind, "joint_encoder_3", share), 5)
    lost = read != clean
    assert abs(lost.sum() - share * SAMPLES) <= expected_lost(share)
    np.testing.assert_array_equal(read[lost], lost_reads)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_lost_sample_repeats_the_last_good_one(share):
    clean, read = samples(broken("encoder_dropout_hold", "joint_encoder_3", share), 5)
    lost = read != clean
    assert abs(lost.sum() - share * SAMPLES) <= expected_lost(share)
    np.testing.assert_array_equal(read[1:][lost[1:]], read[:-1][lost[1:]])


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5])
def test_glitches_are_single_samples_of_the_stated_size_and_share(share):
    clean, read = samples(broken("encoder_glitch", "joint_encoder_3", -5.0 * DEG, share=share), 5)
    spikes = read != clean
    np.testing.assert_array_equal((read - clean)[spikes], np.floor(-5.0 / 360.0 * COUNTS[1] + 0.5))
    assert not np.any(spikes[1:] & spikes[:-1])
    # fewer than of independent samples spread
    assert abs(spikes.sum() - share * SAMPLES) <= expected_lost(share) + 1


def test_another_seed_and_another_fault_with_the_same_seed_lose_other_samples():
    def lost(*faults: Fault) -> list[list[float]]:
        done = run(*faults, last_tick=LAST)
        read = done["estimator.read"][ONSET:END:PERIOD, 3:5]
        return (read == 0.0).T.tolist()

    first = Fault("encoder_dropout_zero", "joint_encoder_1", ONSET, END, 0.5, seed=1)
    again = Fault("encoder_dropout_zero", "joint_encoder_2", ONSET, END, 0.5, seed=1)
    other = Fault("encoder_dropout_zero", "joint_encoder_1", ONSET, END, 0.5, seed=2)
    one, two = lost(first, again)
    assert one != two
    assert lost(other)[0] != one


def test_a_fault_of_lost_numbers_ends_no_run_and_one_behind_it_does_not_either():
    nan = Fault("encoder_dropout_nan", "joint_encoder_1", 10, 20, 1.0)
    late = Fault("sample_delay", "encoder", 0, 100, 4 * TICK)
    done = run(nan, late)
    assert np.isnan(done["estimator.read"][:, 3]).sum() == 10
