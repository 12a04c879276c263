"""Faults that are started by hand: as if their onset had been in the file."""

import os
from collections.abc import Iterator

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.cosim.observers import Observer, simulate
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused
from twin.kernel.process.mailbox import Mailbox
from twin.kernel.recording.recorder import EventLog
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS, RemoteLink
from twin.robot.run.trace import Trace
from twin.robot.run.tuning import Tuning
from twin.robot.run.watch import run_observers

AT = 300
FAULTS = {
    "counts": "{kind='encoder_bias',target='joint_encoder_1',magnitude_deg=2,onset_s=%s}",
    "limited": "{kind='encoder_stuck',target='motor_encoder_2',onset_s=%s,duration_s=0.2}",
    "parameter": "{kind='spring_softened',magnitude_factor=0.5,onset_s=%s,ramp_s=0.1}",
    "drive": "{kind='drive_runaway',target='drive_1',magnitude_rad_per_s=0.2,onset_s=%s}",
    "power": "{kind='power_off',onset_s=%s,duration_s=0.1}",
    "body": "{kind='surface_jump',magnitude_mm=3,onset_s=%s}",
    "breath": "{kind='breathing',magnitude_mm=3,onset_s=%s,duration_s=0.2}",
}


@pytest.fixture
def link() -> Iterator[RemoteLink]:
    fd = os.memfd_create("test mailbox")
    yield RemoteLink(Mailbox(fd, width(SAMPLE_PORTS), width(COMMAND_PORTS)))
    os.close(fd)


class Press(Observer):
    """Presses buttons before the slice that begins at `AT`."""

    halts = (AT,)

    def __init__(self, tuning: Tuning, keys: list[str]):
        self._tuning, self._keys = tuning, keys

    def ready(self, tick: int) -> None:
        for key in self._keys if tick == AT else ():
            self._tuning.request(key, True)


def run(experiment: Experiment, link: RemoteLink, *keys: str) -> tuple[Trace, list[tuple[int, str]], Tuning]:
    with assemble(experiment, remote=link) as assembly:
        own, trace, log = run_observers(experiment, assembly), Trace(), EventLog()
        simulate(
            assembly, experiment.duration_ticks, [Press(own.tuning, list(keys)), *own, trace, log]
        ).require_success()
    return trace, [(event.tick, event.text) for event in log.events if "fault" in event.text], own.tuning


def experiment(fault: str, onset: float) -> Experiment:
    return shipped(FORCE, "duration_s=0.8", "monitor.enabled=true", f"fault=[{fault % onset}]")


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_started_by_hand_is_one_that_begins_there(kind: str, link: RemoteLink):
    ahead, stated, _ = run(experiment(FAULTS[kind], 0.3), link)
    later, events, tuning = run(experiment(FAULTS[kind], 0.6), link, "fault.1.start")
    assert set(later.fields()) == set(ahead.fields())
    for key in ahead.fields():
        np.testing.assert_array_equal(later[key], ahead[key], err_msg=key)
    assert events == stated and [tick for tick, _ in events][:1] == [AT]
    assert tuning.first == "fault.1.start (live)" and tuning.values()["fault.1.start"] is True


def test_a_fault_that_is_not_started_begins_as_in_the_file(link: RemoteLink):
    _, events, tuning = run(experiment(FAULTS["counts"], 0.6), link)
    assert [tick for tick, _ in events] == [600]
    assert tuning.first == "" and tuning.values()["fault.1.start"] is False


def test_the_members_of_a_group_begin_together(link: RemoteLink):
    group = "{kind='encoder_bias',target='all joint encoders',magnitude_deg=2,onset_s=%s}"
    trace, events, _ = run(experiment(group, 0.6), link, "fault.1.start")
    assert [tick for tick, _ in events] == [AT] * 3
    for number in (1, 2, 3):
        assert np.flatnonzero(trace.held(f"fault/{number}.active"))[0] == AT


def test_other_values_and_unknown_faults_are_refused(link: RemoteLink):
    with assemble(experiment(FAULTS["counts"], 0.6), remote=link) as assembly:
        tuning = run_observers(experiment(FAULTS["counts"], 0.6), assembly).tuning
        with pytest.raises(InputRefused, match="expected true, which starts the fault"):
            tuning.request("fault.1.start", False)
        with pytest.raises(InputRefused, match=r"fault\.2\.start"):
            tuning.request("fault.2.start", True)


def test_the_faults_of_a_run_that_is_not_served_have_no_buttons():
    with assemble(shipped()) as assembly:
        assert not any(key.startswith("fault") for key in run_observers(shipped(), assembly).tuning.values())
