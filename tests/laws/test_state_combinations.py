"""Every pair of experiment, drive, kind of fault, scheme and way to isolate goes on from a state as if never stopped.

Here states are taken early, which is quick; `test_state.py` takes them while tasks press.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

import twin
from tests.laws.test_state import EXPERIMENTS, KEEPING, KINDS, SCHEMES, came_to
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import IN_PROCESS_MAKER, assemble
from twin.robot.assembly.isolated_drive import IsolatedDrives
from twin.robot.experiment.fault import FAULT_KINDS

AT, AHEAD = 601, 300
"""An odd tick, at which the fault acts, and the controller is between two calls; and past the end of the fault."""
ONE_INSIDE_ANOTHER = {"brushed_dc", "mx106", "torque_motor_fmi3", "xl330"}
"""Drives of several parts, which cannot repeat a step."""


class Combination(NamedTuple):
    """One value of each factor."""

    experiment: str
    drive: str
    kind: str
    scheme: tuple[str, ...]
    isolate: str

    @property
    def refused(self) -> bool:
        """Whether it is: a drive of several parts, or in another process, cannot repeat its steps."""
        return self.scheme[2].endswith("=2") and (self.drive in ONE_INSIDE_ANOTHER or self.isolate == "drive")


def fault(kind: str) -> str:
    known = FAULT_KINDS[kind]
    magnitude = f", {known.magnitude_key} = {known.magnitudes[1]}" if known.magnitudes else ""
    more = ", share = 0.01" if kind == "encoder_glitch" else ""
    return (
        f'fault=[{{kind = "{kind}", target = "{known.targets[0]}", onset_s = 0.4, duration_s = 0.4{magnitude}{more}}}]'
    )


def goes_on(one: Combination) -> None:
    """Raises AssertionError if it does not."""
    experiment = twin.load(one.experiment, [fault(one.kind), *one.scheme], one.drive)
    maker = IsolatedDrives(keep=True) if one.isolate == "drive" else None
    try:
        with assemble(experiment, maker=maker or IN_PROCESS_MAKER) as assembly:
            simulation = Simulation(assembly.system, experiment.duration_ticks, AT + AHEAD)
            came_to(simulation, AT)
            content = simulation.state().saved().to_bytes()
            expected, failure = simulation.advance(AHEAD).copy(), str(simulation.failure)
    finally:
        if maker is not None:
            maker.__exit__(None, None, None)
    # what an isolated drive has saved is for a drive in this process, too
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, AHEAD)
        simulation.restore(SavedState.from_bytes(content, str(one)))
        np.testing.assert_array_equal(simulation.advance(AHEAD), expected, err_msg=str(one))
        # a fault may lead the robot out of its workspace: at the same tick, in the same words
        assert str(simulation.failure) == failure


def covering() -> Iterator[Combination]:
    """A design in which every pair of values that can be had together is there at least once."""
    plain = [scheme for scheme in SCHEMES if scheme[2].endswith("=1")]
    for (e, experiment), (k, kind) in itertools.product(enumerate(EXPERIMENTS), enumerate(KINDS)):
        drive, scheme = KEEPING[(e + k) % len(KEEPING)], SCHEMES[(3 * e + k + e // 2) % len(SCHEMES)]
        one = Combination(experiment, drive, kind, scheme, "run")
        yield one._replace(scheme=plain[k % len(plain)]) if one.refused else one
    for n in range(max(len(EXPERIMENTS), len(KINDS), len(KEEPING) * len(plain))):
        yield Combination(
            EXPERIMENTS[n % len(EXPERIMENTS)],
            KEEPING[n % len(KEEPING)],
            KINDS[n % len(KINDS)],
            plain[(n + n // len(KEEPING)) % len(plain)],
            "drive",
        )


COVERING = list(covering())


def test_the_design_has_every_pair_that_is_not_refused():
    values = (EXPERIMENTS, KEEPING, KINDS, SCHEMES, ["run", "drive"])
    for i, j in itertools.combinations(range(5), 2):
        wanted = set(itertools.product(values[i], values[j]))
        if (i, j) == (1, 3):
            wanted = {(d, s) for d, s in wanted if not (d in ONE_INSIDE_ANOTHER and s[2].endswith("=2"))}
        if (i, j) == (3, 4):
            wanted = {(s, isolate) for s, isolate in wanted if not (isolate == "drive" and s[2].endswith("=2"))}
        assert wanted <= {(one[i], one[j]) for one in COVERING}
    assert not any(one.refused for one in COVERING)


# a search: `test_state.py` states it for each experiment, drive, kind and scheme
@pytest.mark.slow
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.endurance) for part in range(1, 8))])
def test_every_pair_goes_on_from_a_state(part: int):
    for one in COVERING[part::8]:
        goes_on(one)


@pytest.mark.slow
@pytest.mark.parametrize("isolate", ["run", "drive"])
@pytest.mark.parametrize("drive", KEEPING)
def test_what_is_refused_is_a_drive_of_parts_or_of_another_process_that_would_repeat_steps(drive: str, isolate: str):
    one = Combination("pressing", drive, KINDS[0], SCHEMES[1], isolate)
    assert SCHEMES[1][2] == "cosim.iterations=2"
    if one.refused:
        with pytest.raises(InputRefused, match=r"cannot go back to the start of a step, which iterations"):
            goes_on(one)
    else:
        goes_on(one)


@pytest.mark.endurance
def test_every_experiment_with_every_drive_and_fault_goes_on_from_a_state_in_one_process():
    """Schemes and ways to isolate take turns: all of them with all would be 16 times as many."""
    together = itertools.product(EXPERIMENTS, KEEPING, KINDS)
    for n, (experiment, drive, kind) in enumerate(together):
        one = Combination(experiment, drive, kind, SCHEMES[n % len(SCHEMES)], "drive" if n % 97 == 0 else "run")
        if one.refused:
            one = one._replace(scheme=SCHEMES[0])
        goes_on(one)
