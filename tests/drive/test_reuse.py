"""Instances that are kept for the next run."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from twin.drive.component import acquire, free_kept, keep_instances, release
from twin.drive.description import FmuDescription, described
from twin.drive.instance import Instance
from twin.drive.unpacked import unpacked

TICK = 1e-3


@pytest.fixture
def servo(root: Path) -> Iterator[FmuDescription]:
    keep_instances(True)
    yield described(root / "fmus" / "velocity_servo" / "velocity_servo.fmu")
    keep_instances(False)


def made(fmu: FmuDescription, **parameters: float) -> Instance:
    return acquire("drive_1", fmu, unpacked(fmu.path, fmu.sha256), fmu.settings(parameters), ())


def motion(drive: Instance, omega_ref: float) -> np.ndarray:
    """Motor angle over 20 ticks at a commanded speed (rad/s)."""
    command, angle = (drive.description.variables[name] for name in ("omega_ref", "theta_m"))
    angles = []
    for k in range(20):
        drive.write([(command, omega_ref)])
        drive.advance(k * TICK, TICK)
        angles.append(drive.read([angle]))
    return np.array(angles)


def test_an_instance_that_is_kept_begins_as_a_new_one(servo: FmuDescription):
    first = made(servo)
    new = motion(first, 1.0)
    release(first)
    second = made(servo)
    assert second is first
    assert np.array_equal(motion(second, 1.0), new) and new[-1] > 0.0
    release(second)


def test_two_that_live_at_once_are_two_and_letting_go_twice_keeps_one(servo: FmuDescription):
    first, second = made(servo), made(servo)
    assert first is not second
    release(first)
    release(first)
    assert made(servo) is first and made(servo) is not first


def test_what_was_set_for_a_run_does_not_reach_one_that_does_not_set_it(servo: FmuDescription):
    name = next(v.name for v in servo.offered("parameter"))
    start = servo.variables[name].start
    release(special := made(servo, **{name: start}))
    assert made(servo) is not special
    assert made(servo, **{name: start}) is special


def test_after_a_failure_none_is_kept(servo: FmuDescription):
    release(first := made(servo))
    free_kept()
    assert made(servo) is not first


def test_none_is_kept_where_nobody_has_asked_for_it(servo: FmuDescription):
    keep_instances(False)
    release(first := made(servo))
    assert made(servo) is not first
