"""A remote controller in the place of twin's own: the same robot, watchdog and silence to the tick, waits that end."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.port import by_port, width
from twin.kernel.cosim.simulation import NO_COMPONENT, Simulation
from twin.kernel.errors import ComponentFailed
from twin.kernel.process.mailbox import GIVE_UP_TAG, IGNORED_TAG, Mailbox, MailboxEntry
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import own_monitor
from twin.robot.monitor.reasons import Reason, Trip
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS, RemoteController, RemoteLink
from twin.robot.run.trace import Trace, run_in_memory

WIDTHS = width(SAMPLE_PORTS), width(COMMAND_PORTS)
Answers = Callable[[MailboxEntry, Mailbox], None]


@pytest.fixture
def ends() -> Iterator[tuple[Mailbox, Mailbox]]:
    """Ends of a mailbox: the simulation's, the controller's."""
    fd = os.memfd_create("test mailbox")
    yield Mailbox(fd, *WIDTHS), Mailbox(fd, *WIDTHS)
    os.close(fd)


def served(experiment: Experiment, link: RemoteLink, controller: Mailbox | None, answer: Answers) -> Trace:
    """The signals of an experiment whose samples `answer` answers in another thread."""
    trace, over = Trace(), threading.Event()

    def work() -> None:
        assert controller is not None
        while not over.is_set():
            if sample := controller.samples.pop(0.1):
                answer(sample, controller)

    thread = threading.Thread(target=work) if controller else None
    with assemble(experiment, remote=link) as assembly:
        if thread:
            thread.start()
        try:
            simulate(assembly, experiment.duration_ticks, [trace]).require_success()
        finally:
            over.set()
            if thread:
                thread.join()
    return trace


@pytest.mark.parametrize("name", [FORCE, "pressing"])
def test_a_robot_that_is_sent_its_own_commands_moves_bit_for_bit_as_without_a_wire(
    name: str, ends: tuple[Mailbox, Mailbox]
):
    experiment = load_experiment(name, ["monitor.enabled=false"])
    alone = run_in_memory(experiment)
    source = next(s for s in ("delay", "tank", "controller") if f"{s}.omega_ref" in alone.fields())
    commands = alone.held(f"{source}.omega_ref")

    def answer(sample: MailboxEntry, there: Mailbox) -> None:
        measured = by_port(SAMPLE_PORTS, sample.values)
        np.testing.assert_array_equal(measured["count_m"], alone.held("encoder.count_m")[sample.tick])
        np.testing.assert_array_equal(measured["count_l"], alone.held("encoder.count_l")[sample.tick])
        there.commands.put(sample.tick, commands[sample.tick])

    other = served(experiment, RemoteLink(ends[0], lockstep=True), ends[1], answer)
    assert set(alone.fields()) < set(other.fields())
    for key in alone.fields():
        # the controller's own signals too: it reads the same encoders
        np.testing.assert_array_equal(other[key], alone[key], err_msg=key)
    assert other["remote.answered"].all() and not other["remote.age"].any()


class Stepped(NamedTuple):
    """A run tick by tick: its signals, messages (tick, text), the monitor's trip, number of superseded commands."""

    run: Trace
    messages: list[tuple[int, str]]
    trip: Trip | None
    superseded: int


def real_time(experiment: Experiment, link: RemoteLink, at: dict[int, list[float]], controller: Mailbox) -> Stepped:
    """A run of an experiment with commands that arrive between two ticks, by the tick after."""
    trace = Trace()
    with assemble(experiment, remote=link) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, 1)
        trace.begin(simulation)
        while not simulation.is_over:
            if (command := at.get(simulation.next_tick)) is not None:
                controller.commands.put(-1, command)
            first = simulation.next_tick
            trace.on_rows(first, simulation.advance(1), [])
        assert simulation.failure is None
        remote, monitor = assembly.system.component("remote"), own_monitor(assembly.system)
        assert isinstance(remote, RemoteController)
        trip = monitor.trip if monitor else None
        return Stepped(trace, remote.take_messages(), trip, remote.counts["superseded"])


DOWN = [0.3, 0.3, 0.3]


def test_nothing_moves_and_nothing_counts_before_the_first_command(ends: tuple[Mailbox, Mailbox]):
    experiment = shipped(FORCE, "duration_s=0.5", "monitor.enabled=true")
    run, messages, trip, _ = real_time(experiment, RemoteLink(ends[0], watchdog=0.01, silence=0.1), {}, ends[1])
    assert not run["remote.age"].any() and not run["remote.omega_ref"].any()
    assert trip is None and messages == []
    # the drive droops under the robot's weight all the same
    assert not run["monitor.omega_ref"].any() and not run["monitor.reason"].any()


def test_a_watchdog_stops_the_motors_to_the_tick_and_new_commands_start_them_again(ends: tuple[Mailbox, Mailbox]):
    experiment = shipped(FORCE, "duration_s=0.3")
    period = experiment.controller_ticks
    # samples are at even ticks; a command takes effect at the tick before which it arrives
    at = {50: DOWN, 99: [0.2, 0.0, 0.0], 200: DOWN}
    run, messages, _, _ = real_time(experiment, RemoteLink(ends[0], watchdog=0.06), at, ends[1])
    assert period == 2
    commanded, answered = run.held("remote.omega_ref")[:, 0], np.flatnonzero(run.held("remote.answered"))
    assert answered.tolist() == [50, 99, 200]
    assert (commanded[:50] == 0.0).all() and (commanded[50:99] == 0.3).all()
    assert (commanded[99:159] == 0.2).all() and (commanded[159:200] == 0.0).all()
    assert (commanded[200:260] == 0.3).all() and (commanded[260:] == 0.0).all()
    np.testing.assert_allclose(run.held("remote.age")[[50, 98, 99, 159, 200]], [0.0, 0.048, 0.0, 0.06, 0.0])
    assert [tick for tick, _ in messages] == [159, 200, 260]
    written = iter(ends[1].samples.pop, None)
    assert [(one.tick, one.values[-1]) for one in written if one.tick in (98, 100)] == [
        (98, pytest.approx(0.048)), (100, pytest.approx(0.001)),
    ]  # fmt: skip


@pytest.mark.parametrize("monitored", [True, False])
def test_silence_beyond_the_watchdog_is_a_reason_to_retract_to_the_tick(monitored: bool, ends: tuple[Mailbox, Mailbox]):
    experiment = shipped(FORCE, "duration_s=0.4", f"monitor.enabled={'true' if monitored else 'false'}")
    run, _, trip, _ = real_time(experiment, RemoteLink(ends[0], watchdog=0.01, silence=0.1), {100: DOWN}, ends[1])
    if not monitored:
        assert trip is None
        return
    assert trip is not None and (trip.reason, trip.tick) == (Reason.SILENT, 210)
    assert trip.value == pytest.approx(0.11) and trip.limit == pytest.approx(0.11)
    retreat = run.held("monitor.omega_ref")
    assert (retreat[209] == 0.0).all() and (retreat[210] < 0.0).all()


def test_commands_that_come_again_do_not_end_a_retraction(ends: tuple[Mailbox, Mailbox]):
    experiment, link = shipped(FORCE, "duration_s=0.5", "monitor.enabled=true"), RemoteLink(ends[0], False, 0.01, 0.1)
    again = real_time(experiment, link, {100: DOWN, **dict.fromkeys(range(300, 500, 2), DOWN)}, ends[1])
    assert again.trip is not None and (again.trip.reason, again.trip.tick) == (Reason.SILENT, 210)
    assert (again.run.held("remote.omega_ref")[300:] == 0.3).all()
    sent = again.run.held("monitor.omega_ref")
    assert (sent[210] < 0.0).all() and (sent[300:] <= 0.0).all()
    assert (again.run.held("monitor.reason")[210:] == Reason.SILENT).all()


def test_without_a_watchdog_commands_are_held_for_ever(ends: tuple[Mailbox, Mailbox]):
    experiment = shipped(FORCE, "duration_s=0.4", "monitor.enabled=true")
    run, _, trip, _ = real_time(experiment, RemoteLink(ends[0], silence=0.1), {100: [0.01, 0.01, 0.01]}, ends[1])
    assert (run.held("remote.omega_ref")[100:] == 0.01).all() and trip is None


def test_the_newest_command_before_a_tick_counts_and_the_others_are_counted(ends: tuple[Mailbox, Mailbox]):
    for value in (0.1, 0.2, 0.3):
        ends[1].commands.put(-1, [value] * 3)
    ends[1].commands.put(-1, [9.0] * 3, IGNORED_TAG)
    run, _, _, superseded = real_time(shipped(FORCE, "duration_s=0.1"), RemoteLink(ends[0]), {}, ends[1])
    assert (run["remote.omega_ref"] == 0.3).all() and superseded == 2


def test_an_invalid_command_trips_a_monitor_and_is_left_out_without_one(ends: tuple[Mailbox, Mailbox]):
    bad = {20: DOWN, 30: [np.nan, 0.0, 0.0], 32: [np.inf, 0.0, 0.0]}
    experiment = shipped(FORCE, "duration_s=0.1", "monitor.enabled=true")
    trip = real_time(experiment, RemoteLink(ends[0]), bad, ends[1]).trip
    assert trip is not None
    assert (trip.reason, trip.tick) == (Reason.INVALID_COMMAND, 30)


def test_an_invalid_command_without_a_monitor_keeps_the_last_valid_one(ends: tuple[Mailbox, Mailbox]):
    bad = {20: DOWN, 30: [np.nan, 0.0, 0.0], 32: [np.inf, 0.0, 0.0]}
    link = RemoteLink(ends[0], watchdog=0.02)
    run, messages, _, _ = real_time(shipped(FORCE, "duration_s=0.1"), link, bad, ends[1])
    commanded = run.held("remote.omega_ref")[:, 0]
    # and it is no sign of life: the watchdog counts from the last valid one
    assert (commanded[20:40] == 0.3).all() and (commanded[40:] == 0.0).all()
    assert [(tick, "not a number" in text) for tick, text in messages] == [(30, True), (40, False)]


def test_a_sample_without_an_answer_ends_the_run_when_the_wire_gives_up(ends: tuple[Mailbox, Mailbox]):
    def answer(sample: MailboxEntry, there: Mailbox) -> None:
        there.commands.put(sample.tick, DOWN, GIVE_UP_TAG if sample.tick == 40 else 0)

    with pytest.raises(ComponentFailed, match=r"got no answer to its sample at t = 0.04 s, tick 40"):
        served(shipped(FORCE, "duration_s=0.1"), RemoteLink(ends[0], lockstep=True), ends[1], answer)


def test_an_answer_to_another_tick_is_no_answer(ends: tuple[Mailbox, Mailbox]):
    def answer(sample: MailboxEntry, there: Mailbox) -> None:
        there.commands.put(sample.tick - 2, [7.0] * 3)
        there.commands.put(sample.tick + 2, [8.0] * 3)
        there.commands.put(sample.tick, [0.1] * 3)

    run = served(shipped(FORCE, "duration_s=0.1"), RemoteLink(ends[0], lockstep=True), ends[1], answer)
    assert (run["remote.omega_ref"] == 0.1).all()


def test_an_exception_ends_a_wait_in_lockstep_and_no_component_is_marked_meanwhile(ends: tuple[Mailbox, Mailbox]):
    marks: list[int] = []
    experiment = shipped(FORCE, "duration_s=0.1")

    def check() -> None:
        marks.append(int(simulation._mark[1]))
        if len(marks) == 3:
            raise KeyboardInterrupt

    began = time.monotonic()
    with assemble(experiment, remote=RemoteLink(ends[0], lockstep=True, check=check)) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks)
        with pytest.raises(KeyboardInterrupt):
            simulation.advance()
    assert marks == [NO_COMPONENT] * 3
    assert time.monotonic() - began < 30.0


def test_a_fault_of_the_controllers_messages_is_one_of_the_remote_controllers(ends: tuple[Mailbox, Mailbox]):
    late = "fault=[{kind='controller_overrun',magnitude_ms=10,onset_s=0.0}]"
    run = real_time(shipped(FORCE, "duration_s=0.1", late), RemoteLink(ends[0]), {20: DOWN}, ends[1]).run
    commanded, arriving = run.held("remote.omega_ref")[:, 0], run.held("fault/1.omega_ref")[:, 0]
    assert np.flatnonzero(commanded)[0] == 20 and np.flatnonzero(arriving)[0] == 30


def test_samples_have_what_a_robot_measures(ends: tuple[Mailbox, Mailbox]):
    experiment = shipped(FORCE, "duration_s=0.05")
    run = real_time(experiment, RemoteLink(ends[0]), {}, ends[1]).run
    samples = list(iter(ends[1].samples.pop, None))
    assert [one.tick for one in samples] == list(range(0, 51, 2)) and len({one.tag for one in samples}) == 1
    for one in samples:
        measured = by_port(SAMPLE_PORTS, one.values)
        np.testing.assert_array_equal(measured["count_m"], run.held("encoder.count_m")[one.tick])
        assert measured["F_z"][0] == run.held("scale.F_z")[max(0, one.tick - 1)]
        # torques at the end of the step before, in effect at this tick
        torque = [run.held(f"drive/{n}.tau_motor")[one.tick] for n in (1, 2, 3)]
        np.testing.assert_array_equal(measured["tau_motor"], torque)
