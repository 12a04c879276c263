"""What says what is normal may begin later than the log."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.replay.logs import ANGLES, FIG4, NOISE, drifting, healthy, judged, ran, softened, write_log
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogError
from twin.kernel.recording.logs.reader import read_log, recording_log
from twin.kernel.recording.reader import read
from twin.studies.replay.model import recorded_model
from twin.studies.replay.recording import record
from twin.studies.replay.replay import _indicator, normal_time, replay_log
from twin.studies.replay.samples import robot_samples


def test_a_time_is_the_beginning_and_two_times_leave_out_what_is_before():
    assert normal_time("2.5") == (0.0, 2.5) and normal_time("1:3") == (1.0, 3.0)


@pytest.mark.parametrize(
    "text", ["0", "-1", "3:1", "1:1", "-1:2", "a", "1:", ":2", "1:2:3", "nan", "inf", "", "1_0", "\u0661"]
)
def test_what_is_no_time_is_refused_with_an_example(text: str):
    with pytest.raises(InputRefused, match=r"^--baseline .*: expected a time > 0 s, or FROM:TO .* for example 1:3$"):
        normal_time(text)


@pytest.mark.parametrize("step", [0.0, 1.7e9])
def test_a_log_with_samples_for_more_than_three_years_is_in_another_unit_but_a_clock_may_step(
    tmp_path: Path, step: float
):
    log = read_log(write_log(tmp_path / "log.csv", ran(FIG4), angles=True), column_map(ANGLES))

    def retimed(factor: float) -> Log:
        times = {name: factor * one.t + step * (one.t > 10.0) for name, one in log.series.items()}
        return replace(log, series={name: replace(one, t=times[name]) for name, one in log.series.items()})

    assert len(robot_samples(retimed(1.0), healthy().belief).t) == 10001
    with pytest.raises(LogError, match=r"has samples for 1\S*e\+08 s, expected at most 1e\+08 s; is its unit right"):
        robot_samples(retimed(6e6), healthy().belief)


def test_a_start_that_is_not_normal_is_an_alarm_only_if_it_is_taken_for_normal():
    t = np.arange(0.0, 20.0, 0.01)
    r = np.where(t < 1.0, 5.0, 0.0) + 0.01 * np.random.default_rng(0).normal(size=len(t))
    (taken,) = _indicator("force", "N", t, r, (0.0, 1.0), 0.1, 0.01)
    (left_out,) = _indicator("force", "N", t, r, (1.0, 3.0), 0.1, 0.01)
    assert not taken.drift.matches and left_out.drift.matches
    assert left_out.t[0] == 1.0 and abs(left_out.drift.baseline) < 0.01


FORCE = "scale.F_z=scale.F_z"


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A robot's log of counts."""
    return write_log(tmp_path_factory.mktemp("logs") / "log.csv", ran(FIG4)).read_text()


def refused(path: Path, text: str, *maps: str) -> str:
    path.write_text(text)
    with pytest.raises(InputRefused) as problem:
        replay_log(read_log(path, column_map(maps)), healthy())
    sentence = str(problem.value)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence
    return sentence


def test_columns_that_are_not_encoders_are_told_with_a_map_to_choose_from(tmp_path: Path, text: str):
    said = refused(tmp_path / "a.csv", text.replace("encoder.count_m", "motor"))
    assert "neither encoder.count_m[0..2] nor estimator.theta_m[0..2] is there; it has motor[0]" in said
    assert "choose with --map 'estimator.theta_m[0]=COLUMN[deg]'" in said


def test_a_missing_joint_is_told(tmp_path: Path, text: str):
    assert "expected 3, one per joint" in refused(tmp_path / "a.csv", text.replace("encoder.count_m[2]", "other"))


def test_a_force_in_another_unit_is_told(tmp_path: Path, text: str):
    said = refused(tmp_path / "a.csv", text.replace("scale.F_z_N", "scale.F_z_mm"))
    assert "scale.F_z is in 'm', expected 'N'; declare its unit with --map" in said
    said = refused(tmp_path / "a.csv", text.replace("scale.F_z_N", "scale.F_z_g"))
    grams = "grams are a mass: did you mean gf (or kgf)? declare its unit with --map"
    assert f"scale.F_z is in 'kg', expected 'N'; {grams}" in said


def test_a_field_that_is_no_number_is_told_with_its_line(tmp_path: Path, text: str):
    lines = text.splitlines()
    lines[10] = lines[10].replace("497", "nan")
    assert " line 11" in refused(tmp_path / "a.csv", "\n".join(lines))


def test_times_that_run_backwards_are_told_with_their_line(tmp_path: Path, text: str):
    lines = text.splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    assert "runs backwards" in refused(tmp_path / "a.csv", "\n".join(lines))


def test_a_log_that_begins_before_zero_is_told(tmp_path: Path, text: str):
    head, first, *rest = text.splitlines()
    said = refused(tmp_path / "a.csv", "\n".join([head, "-1.0" + first[3:], *rest]))
    assert "begins at -1 s, before 0" in said


def test_angles_that_no_pose_fits_are_told_with_what_may_be_wrong(tmp_path: Path):
    path = write_log(tmp_path / "q.csv", ran(FIG4), angles=True)
    head, _, *rest = path.read_text().splitlines()
    said = refused(path, "\n".join([head, "0.0,0,0,0,0,40,170,0", *rest]), *ANGLES, FORCE)
    assert "fit no pose of the robot; are their signs, units and zeros those of the experiment?" in said


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "an empty file"),
        (b"\x89MCAP0\r\n", "damaged"),
        (b"\x00\x01\x02\x03", "not a text file"),
    ],
)
def test_files_that_are_no_logs_are_one_sentence(tmp_path: Path, content: bytes, said: str):
    path = tmp_path / "log.bin"
    path.write_bytes(content)
    with pytest.raises(InputRefused) as problem:
        replay_log(read_log(path, {}), healthy())
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)


def test_a_damaged_recording_is_one_sentence(tmp_path: Path):
    content = bytearray(ran(FIG4).path.read_bytes())
    content[len(content) // 2] ^= 1
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(InputRefused, match="damaged at byte"):
        read_log(path, {})


def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes_and_says_so(tmp_path: Path):
    content = ran(FIG4).path.read_bytes()
    path = tmp_path / "run.mcap"
    path.write_bytes(content[: len(content) // 2])
    replay = replay_log(read_log(path, {}), healthy())
    assert "unfinished recording" in replay.log.notes[0]
    assert 5.0 < replay.log.t[-1] < 15.0


TASKS = ("pressing", "tapping", "rolling", "pushing")
ALL_SOFT = softened((1, 2, 3), 10.0)


@pytest.mark.parametrize("name", [FIG4, "tapping"])
def test_a_run_put_through_its_own_estimator_gives_its_estimates_bit_for_bit(name: str):
    run = ran(name)
    replay = replay_log(recording_log(run), recorded_model(run.metadata, run.path))
    for port in ("theta_m", "theta_l", "p_B", "J", "tau_l", "F_ee_B"):
        assert replay.estimator[port].tobytes() == run[f"estimator.{port}"].tobytes(), port


def test_estimates_of_a_run_with_faulty_encoders_are_those_of_what_the_computer_received():
    run = ran("pressing", drifting(4.0))
    replay = replay_log(recording_log(run), recorded_model(run.metadata, run.path))
    np.testing.assert_array_equal(replay.estimator["F_ee_B"], run["estimator.F_ee_B"])


def test_a_log_of_angles_gives_the_estimates_of_its_counts(tmp_path: Path):
    log = read_log(write_log(tmp_path / "q.csv", ran(FIG4), angles=True), column_map([*ANGLES, "scale.F_z=scale.F_z"]))
    replay = replay_log(log, healthy())
    # degrees and back: 1e-15 rad in 1 rad, times 40 N/rad
    np.testing.assert_allclose(replay.estimator["F_ee_B"], ran(FIG4)["estimator.F_ee_B"], rtol=0, atol=1e-12)


def test_the_plant_model_follows_a_healthy_robot_within_the_rounding_of_its_encoders():
    replay = judged(FIG4)
    assert replay.plant is not None
    r = replay.plant["theta_l"] - ran(FIG4)["plant.theta_l"][::2]
    # half a motor count through the belt, 0.38 mrad, and the swing that its steps excite: up to twice that
    assert np.max(np.abs(r)) < 3 * np.pi / 4096
    # half a count on the motors is 0.05 N of a robot that presses on a scale of 1250 N/m through springs of 2137 N/m
    assert replay.statistics["plant"].rms < 0.05


@pytest.mark.parametrize("name", [FIG4, "fig4_position", "fig4_imperfect", *TASKS])
def test_a_healthy_robot_matches_its_twin(name: str):
    replay = judged(name)
    assert len(replay.indicators) == 4
    assert replay.first_alarm is None


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["pressing", "tapping"])
def test_noise_on_the_encoders_is_no_drift(name: str, seed: int):
    assert judged(name, *NOISE, f"seed={seed}").first_alarm is None


@pytest.mark.parametrize("settings", [(ALL_SOFT,), (*NOISE, "seed=1", ALL_SOFT)])
def test_springs_that_soften_by_a_tenth_are_seen_within_three_blocks(settings: tuple[str, ...]):
    first = judged(FIG4, *settings).first_alarm
    assert first is not None
    assert 10.0 < first.drift.alarm <= 13.0
    assert first.drift.since == pytest.approx(10.0, abs=first.drift.block)


def test_softer_springs_make_the_estimate_read_above_the_measured_force():
    replay = judged(FIG4, ALL_SOFT, plant=False)
    # the controller holds 5 N of estimate, of which 0.9 are real before the weight is taken off
    assert replay.indicators[0].drift.size == pytest.approx(0.28, abs=0.03)


def test_one_soft_spring_that_the_force_hardly_shows_is_seen_by_its_own_joint():
    replay = judged("pressing", softened((1,), 6.0))
    _, joint_1, joint_2, joint_3 = replay.indicators
    assert replay.first_alarm is joint_1
    assert joint_2.drift.matches and joint_3.drift.matches
    assert 6.0 < joint_1.drift.alarm <= 9.0


def test_an_encoder_that_drifts_is_seen_before_it_is_half_a_degree_off():
    first = judged(FIG4, drifting(6.0)).first_alarm
    assert first is not None
    assert 6.0 < first.drift.alarm <= 11.0


def test_another_k_s_than_believed_is_seen_with_the_contact_and_not_in_free_air():
    first = judged(FIG4, "plant.k_s_Nm_per_rad=0.9").first_alarm
    assert first is not None
    contact = float(ran(FIG4).time("plant")[np.argmax(ran(FIG4)["plant.F_n"] > 0)])
    assert contact - 1.0 < first.drift.since < contact + 2.0


def test_without_measured_force_and_plant_model_a_wrong_k_s_cannot_be_seen_and_nothing_is_claimed(tmp_path: Path):
    run = ran(FIG4, "plant.k_s_Nm_per_rad=0.9")
    names = [f"encoder.{name}[{i}]" for name in ("count_m", "count_l") for i in range(3)]
    log = read_log(write_log(tmp_path / "log.csv", run), column_map([f"{name}={name}" for name in names]))
    replay = replay_log(log, healthy())
    assert replay.indicators == ()
    assert replay.forces == {}


def test_lost_samples_cost_no_others_and_are_told(tmp_path: Path):
    run = ran(FIG4)
    keep = np.ones(len(run.time("encoder")), dtype=bool)
    keep[1000:1010] = keep[4000:4500] = False
    replay = replay_log(read_log(write_log(tmp_path / "log.csv", run, keep)), healthy(), plant=True)
    np.testing.assert_array_equal(replay.estimator["F_ee_B"], run["estimator.F_ee_B"][keep])
    assert replay.log.sampling.missing == 510
    # 20 ms are bridged, after 1 s the plant model restarts
    assert replay.starts == (0.0, 9.0)
    assert replay.first_alarm is None


def test_a_replay_is_a_recording_that_can_be_replayed(tmp_path: Path):
    run = ran(FIG4)
    replay = replay_log(recording_log(run), recorded_model(run.metadata, run.path), plant=True)
    first, second = (record(replay, tmp_path / f"{name}.mcap") for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    again = read(first)
    np.testing.assert_array_equal(again["estimator.F_ee_B"], run["estimator.F_ee_B"])
    np.testing.assert_array_equal(again.time("estimator"), run.time("estimator"))
    once_more = replay_log(recording_log(again), recorded_model(again.metadata, again.path), plant=True)
    np.testing.assert_array_equal(once_more.estimator["F_ee_B"], run["estimator.F_ee_B"])


def test_a_log_whose_clock_is_uneven_is_recorded_sample_by_sample(tmp_path: Path):
    run = ran("pressing")
    keep = np.random.default_rng(0).random(len(run.time("encoder"))) > 0.2
    replay = replay_log(read_log(write_log(tmp_path / "log.csv", run, keep)), healthy("pressing"))
    again = read(record(replay, tmp_path / "run.mcap"))
    np.testing.assert_array_equal(again.time("estimator"), run.time("encoder")[keep])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"baseline": (0.0, 30.0)}, "expected at least 20 there and more after them; choose with --baseline S"),
        ({"baseline": (0.0, 0.01)}, "with 5 samples in the first 0.01 s"),
        ({"tolerance": -1.0}, "--tolerance -1: expected a force >= 0 N"),
    ],
)
def test_what_cannot_be_judged_is_refused_with_the_remedy(arguments: dict[str, float], said: str):
    with pytest.raises(InputRefused, match=said):
        replay_log(recording_log(ran(FIG4)), healthy(), **arguments)  # type: ignore[arg-type]


def with_invalid(text: str, columns: Sequence[int], rows: Sequence[int], cell: str) -> str:
    lines = [line.split(",") for line in text.splitlines()]
    for row in rows:
        for column in columns:
            lines[row + 1][column] = cell
    return "\n".join(map(",".join, lines)) + "\n"


@pytest.mark.parametrize("cell", ["nan", "inf", "null"])
@pytest.mark.parametrize("columns", [(1,), (4, 5, 6), (1, 2, 3, 4, 5, 6)])
def test_up_to_5_percent_of_invalid_counts_are_left_out_and_more_are_refused(
    tmp_path: Path, text: str, cell: str, columns: tuple[int, ...]
):
    count = len(text.splitlines()) - 1
    few = range(100, 100 + count // 20)
    path = tmp_path / "a.csv"
    path.write_text(with_invalid(text, columns, few, cell))
    log = robot_samples(read_log(path), healthy().belief)
    assert len(log.t) == count - len(few)
    assert any(f"{len(few)} of {count} samples are not a number" in note for note in log.notes)
    said = refused(path, with_invalid(text, columns, range(100, 102 + count // 20), cell))
    assert f"{count // 20 + 2} of {count} samples of an encoder are NaN, null or infinite" in said
    # a sound part of it is read
    sound = read_log(path, part=(10.0, None))
    assert len(robot_samples(sound, healthy().belief).t) == count // 2 + 1


@pytest.mark.parametrize("seconds", [40e-6, -40e-6, 0.9e-3])
def test_joints_that_are_stamped_a_little_apart_from_the_motors_belong_to_them(
    tmp_path: Path, text: str, seconds: float
):
    (tmp_path / "a.csv").write_text(text)
    log = read_log(tmp_path / "a.csv")
    apart = {
        name: replace(one, t=one.t + seconds * ("count_l" in name) + 1.0 * (seconds < 0))
        for name, one in log.series.items()
    }
    whole, found = (robot_samples(one, healthy().belief) for one in (log, replace(log, series=apart)))
    assert np.array_equal(found.counts, whole.counts)
    half = {name: replace(one, t=one.t + 50.0 * ("count_l" in name)) for name, one in log.series.items()}
    with pytest.raises(LogError, match="motor and joint encoders have different times"):
        robot_samples(replace(log, series=half), healthy().belief)
