"""What holds of every kind in the catalogue, on every one of its targets."""

import numpy as np
import pytest

from tests.robot.faults.robot import PERIOD, TICK, Robot, Run, run
from twin.kernel.errors import ComponentFailed
from twin.robot.experiment.fault import FAULT_KINDS, Fault

ONSET, END = 41, 81
LAST = 120
# in 40 ms a drift moves less than a count: here it is 100 times as fast
SI = {"ms": 1e-3, "deg": np.pi / 180.0, "deg_per_s": 100.0 * np.pi / 180.0}

COMMANDS = ("controller_overrun", "command_held", "command_lost")
"""Messages that carry commands."""
PARAMETER_ENDS = [f"plant.{name}" for name in ("k_s_share", "backlash_added", "b_j_added", "slip", "K")] + [
    "estimator.k_s",
    "estimator.eta",
]
EVERY = [(kind, target) for kind, known in FAULT_KINDS.items() for target in known.targets]
RUNNING = [
    (kind, target) for kind, target in EVERY if kind != "drive_failure" and FAULT_KINDS[kind].mechanism != "body"
]
ROBOTS = [Robot(), Robot(three_axes=True, power_off=LAST + 1)]


def fault(kind: str, target: str, size: int = 2, onset: int = ONSET, end: int = END) -> Fault:
    """`kind` with its small (0), medium or large (2) magnitude of the catalogue."""
    known = FAULT_KINDS[kind]
    magnitude = known.magnitudes[size] * SI.get(known.unit or "", 1.0) if known.magnitudes else 0.0
    return Fault(kind, target, onset, end, magnitude, share=0.3, seed=5)


def signal(done: Run, kind: str) -> np.ndarray:
    """What the fault acts on, one row per tick; of motors their speed, because where a motor is it stays."""
    mechanism = FAULT_KINDS[kind].mechanism
    if mechanism == "parameter":
        return np.hstack([done[end] for end in PARAMETER_ENDS])
    if kind in COMMANDS or mechanism in ("command", "drive"):
        return np.diff(done["plant.seen"], axis=0) / TICK
    return done["estimator.read"]


def allowed(kind: str) -> np.ndarray:
    """Ticks at which the signal may differ from the clean one."""
    ticks = np.arange(LAST + 1)
    if FAULT_KINDS[kind].mechanism in ("counts", "message") and kind not in COMMANDS:
        # the reader looks every PERIOD ticks and keeps what it saw
        seen = ticks - ticks % PERIOD
        return (seen >= ONSET) & (seen < END)
    if FAULT_KINDS[kind].mechanism in ("parameter", "body"):
        # written before plant and estimator step; the plant tells it one tick later, the estimator when it looks
        return (ticks >= ONSET) & (ticks <= END + PERIOD)
    return (ticks[:-1] >= ONSET) & (ticks[:-1] < END)


@pytest.mark.parametrize("robot", ROBOTS, ids=["three drives", "one drive, monitor"])
@pytest.mark.parametrize(("kind", "target"), RUNNING)
def test_a_fault_shows_between_onset_and_end_and_nowhere_else(kind, target, robot):
    clean = signal(run(robot=robot, last_tick=LAST), kind)
    faulty = signal(run(fault(kind, target), robot=robot, last_tick=LAST), kind)
    # speeds come from differences of angles of about 1 rad: 1e-16 rad over a tick
    differs = np.any(~np.isclose(faulty, clean, rtol=0.0, atol=1e-11), axis=1)
    assert differs.any()
    assert not np.any(differs & ~allowed(kind))


@pytest.mark.parametrize(("kind", "target"), RUNNING)
def test_a_fault_that_never_begins_changes_no_bit(kind, target):
    clean, faulty = run(), run(fault(kind, target, onset=10_000, end=20_000))
    for end in ("estimator.read", "plant.seen", *PARAMETER_ENDS):
        np.testing.assert_array_equal(faulty[end], clean[end])


@pytest.mark.parametrize(("kind", "target"), RUNNING)
def test_the_fault_tells_when_it_is_active(kind, target):
    done = run(fault(kind, target, onset=40, end=80))
    active = done["fault_1.active"][:, 0]
    ticks = np.arange(LAST + 1)
    # of a continuous component the row of a tick shows the step that led to it
    late = 1 if FAULT_KINDS[kind].mechanism == "drive" else 0
    np.testing.assert_array_equal(active, (ticks >= 40 + late) & (ticks < 80 + late))


@pytest.mark.parametrize(
    "kind", [kind for kind, known in FAULT_KINDS.items() if known.magnitudes and known.unit != "ms"]
)
def test_every_magnitude_of_the_catalogue_lets_the_robot_run(kind):
    for size in range(3):
        assert len(run(fault(kind, FAULT_KINDS[kind].targets[0], size)).rows) == LAST + 1


@pytest.mark.parametrize(("kind", "target"), RUNNING)
def test_the_same_seed_gives_the_same_bytes(kind, target):
    assert run(fault(kind, target)).rows.tobytes() == run(fault(kind, target)).rows.tobytes()


@pytest.mark.parametrize(("kind", "target"), [pair for pair in EVERY if FAULT_KINDS[pair[0]].mechanism == "body"])
def test_faults_of_the_body_are_left_to_the_body(kind, target):
    done = run(fault(kind, target))
    assert [c.name for c in done.system.components] == [c.name for c in run().system.components]


@pytest.mark.parametrize("target", FAULT_KINDS["drive_failure"].targets)
def test_a_drive_that_fails_ends_the_run_with_the_name_of_the_fault(target):
    with pytest.raises(ComponentFailed) as failure:
        run(fault("drive_failure", target))
    told = f"[[fault]] 1 (fault_1) made {target} fail (drive_failure) in the step from t = 0.041 s, tick 41."
    assert str(failure.value).startswith(told)
