"""Remote controller as a co-simulation component: samples of a robot's measurements out, motor speeds in.

The component exchanges both with another process through a mailbox. It takes the place of twin's own controller for
the drives, before the safety monitor, and has no input that a robot does not measure.

In real time a step never waits: at every tick it takes the newest command that has arrived, and holds it until the
next one. If no command arrives for the time of the watchdog, the commanded speeds are 0. In lockstep a step writes its
sample, and waits for the command that answers it. Before the first command nothing moves, and neither watchdog nor
monitor counts.
"""

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import NativeComponent, call_step, doubles_at, integers_at, step_function
from twin.kernel.cosim.deadlines import DEADLINE_RECORD, Deadlines
from twin.kernel.cosim.port import Port, memory_of, record, states, width
from twin.kernel.cosim.python_class import STEP_FUNCTION
from twin.kernel.cosim.simulation import NO_COMPONENT
from twin.kernel.errors import EndRequest
from twin.kernel.process.mailbox import (
    CAPACITY,
    GIVE_UP_TAG,
    HEAD_SIZE,
    OBEYED_TAG,
    Mailbox,
    entry_address,
    publish_entry,
    unread_count,
    wait_for_entry,
    write_head,
)
from twin.kernel.process.shared_memory import SLEEP_INTERVAL, monotonic_ns, syscall_numbers, timespec

MEASURED_PORTS = (
    Port("count_m", 3, "1", "motor encoder counts"),
    Port("count_l", 3, "1", "joint encoder counts"),
    Port("sample", 1, "1", "number of the encoder message"),
)
SCALE_PORT = Port("F_z", 1, "N", "reading of the scale, pressing positive")
EFFORT_PORT = Port("tau_motor", 3, "N m", "torques that the motors produce")
OMEGA_REF = Port("omega_ref", 3, "rad/s", "motor speeds that the remote controller commands")
AGE_PORT = Port("age", 1, "s", "time since the last command took effect; 0 before the first")
REMOTE_OUTPUTS = (
    OMEGA_REF,
    AGE_PORT,
    Port("answered", 1, "1", "whether a command took effect in this tick", "bool"),
)
SAMPLE_PORTS = (*MEASURED_PORTS, SCALE_PORT, EFFORT_PORT, OMEGA_REF, AGE_PORT)
"""Values of a sample in the mailbox: measurements, NaN if missing; commanded speeds in effect, and their age."""
COMMAND_PORTS = (OMEGA_REF,)
"""Values of a command in the mailbox."""
STOPPED_EVENT, RESUMED_EVENT, INVALID_EVENT = 1, 2, 3
EVENT_TEXTS = {
    STOPPED_EVENT: "no command within the watchdog's time: commanded speeds set to 0",
    RESUMED_EVENT: "commands arrive again",
    INVALID_EVENT: "a command that is not a number",
}
MAX_TICKS = 2**53
"""Maximum time of the watchdog (ticks), also if it is infinite: an integer that every float can express."""
MAX_EVENTS = 64
"""Maximum number of events between two slices; later ones are dropped."""
GAVE_UP_STATUS, INTERRUPTED_STATUS = 2, 3
"""Step statuses: no answer to a sample, and an exception while the step waited for one."""
_MEASURED_WIDTH, _SAMPLE_WIDTH, _COMMAND_WIDTH = map(width, (MEASURED_PORTS, SAMPLE_PORTS, COMMAND_PORTS))
_integers, _deadlines_at = pointer_to(np.int64), pointer_to(DEADLINE_RECORD)
REMOTE_MEMORY = record(
    kernel="i8",  # see `syscall_numbers`
    info="i8",  # address of a struct timespec
    nap="i8",  # maximum time of one sleep, address of a struct timespec
    samples="i8",  # address of the ring of samples
    commands="i8",  # address of the ring of commands
    check="i8",  # function with the signature of a step, called after each sleep without an answer
    deadlines="i8",  # address of a `DEADLINE_RECORD`; 0 without pacing
    mark="i8",  # address of the simulation's mark, see `LOOP_RECORD`; 0 without one
    lockstep="i8",
    monitored="i8",  # whether a monitor reads the commands, so that invalid ones are passed on
    scale="i8",
    effort="i8",
    call="i8",  # ticks between two calls
    period="i8",  # ticks between two samples
    watchdog="i8",  # ticks; 0 for none
    events="i8",  # address of (MAX_EVENTS, 2) integers: tick, event
    **states(
        tick="i8",
        written="i8",  # number of the last sample
        read="i8",  # number of the last command read
        applied="i8",  # number of the command in effect; 0 before the first
        since="i8",  # tick at which it took effect
        omega_ref="3f8",
        stopped="i8",  # whether the watchdog has set the speeds to 0
        event_count="i8",
        superseded="i8",  # number of commands replaced by a newer one before a tick
        invalid="i8",  # number of commands with NaN or infinity
        distorted="i8",  # whether the last command was one
    ),
)


@dataclass(frozen=True)
class RemoteLink:
    """Link from the served robot to a remote controller: the mailbox, and the rules of its commands.

    Attributes:
        lockstep: whether each sample waits for its answer.
        watchdog: time without a command (s) after which the commanded speeds are 0; 0 for none.
        silence: further time (s) after which the safety monitor trips; 0 for none.
        check: called about every `SLEEP_INTERVAL` s while a step waits for an answer. An exception ends the run and is
            raised again; an EndRequest ends it regularly.
    """

    mailbox: Mailbox
    lockstep: bool = False
    watchdog: float = 0.0
    silence: float = 0.0
    check: Callable[[], None] = lambda: None

    @property
    def silence_limit(self) -> float:
        """Age of a command (s) at which the safety monitor trips; infinite for none."""
        limited = self.silence > 0.0 and self.watchdog > 0.0 and not self.lockstep
        return self.watchdog + self.silence if limited else math.inf


@njit(cache=True)
def _note_event(m, event):
    if m.event_count < MAX_EVENTS:
        there = carray(_integers(m.events + 16 * m.event_count), 2)
        there[0], there[1] = m.tick, event
        m.event_count += 1


@njit(cache=True)
def _read_commands(m):
    """Read all new commands; return the tag of the last one that counts, or -1 without one.

    In lockstep a command counts if it answers this tick.
    """
    found, number, there = -1, 0, 0
    unread = unread_count(m.commands, m.read)
    if unread > CAPACITY - 1:
        m.read += unread - (CAPACITY - 1)
        unread = CAPACITY - 1
    for _ in range(unread):
        m.read += 1
        address = entry_address(m.commands, _COMMAND_WIDTH, m.read)
        head = carray(_integers(address), HEAD_SIZE)
        if head[3] == GIVE_UP_TAG:
            return GIVE_UP_TAG
        if head[3] != OBEYED_TAG or (m.lockstep and head[1] != m.tick):
            continue
        values = carray(doubles_at(address + 8 * HEAD_SIZE), _COMMAND_WIDTH)
        if not np.isfinite(values[0] + values[1] + values[2]):
            # one event for consecutive ones
            if not m.distorted:
                _note_event(m, INVALID_EVENT)
            m.distorted, m.invalid = 1, m.invalid + 1
            if not m.monitored:
                continue
        else:
            m.distorted = 0
        if found == OBEYED_TAG:
            m.superseded = m.superseded + 1
        found, number, there = OBEYED_TAG, m.read, address + 8 * HEAD_SIZE
    if found == OBEYED_TAG:
        values = carray(doubles_at(there), _COMMAND_WIDTH)
        for i in range(_COMMAND_WIDTH):
            m.omega_ref[i] = values[i]
        m.applied, m.since = number, m.tick
        if m.stopped:
            m.stopped = 0
            _note_event(m, RESUMED_EVENT)
    return found


@njit(cache=True)
def _watch_commands(m):
    """Set the commanded speeds to 0 if the last command is older than the watchdog's time."""
    if m.watchdog > 0 and m.applied > 0 and not m.stopped and m.tick - m.since >= m.watchdog:
        m.stopped = 1
        _note_event(m, STOPPED_EVENT)
        for i in range(_COMMAND_WIDTH):
            m.omega_ref[i] = 0.0


@njit(cache=True)
def _write_sample(m, u, age):
    """Write the measurements `u` and the commands in effect as a sample."""
    m.written += 1
    now = monotonic_ns(m.kernel, m.info)
    if m.deadlines != 0:
        # the deadline, not the present time: stamps of a robot's own loop do not jitter
        pace = carray(_deadlines_at(m.deadlines), 1)[0]
        now = pace.begun + np.int64(np.rint(m.tick * pace.tick))
    address = write_head(m.samples, _SAMPLE_WIDTH, m.written, m.tick, now, m.applied)
    there = carray(doubles_at(address), _SAMPLE_WIDTH)
    for j in range(_MEASURED_WIDTH):
        there[j] = u[j]
    place, taken = _MEASURED_WIDTH, _MEASURED_WIDTH
    there[place] = u[taken] if m.scale else np.nan
    taken += m.scale
    for i in range(3):
        there[place + 1 + i] = u[taken + i] if m.effort else np.nan
        there[place + 4 + i] = m.omega_ref[i]
    there[place + 7] = age
    publish_entry(m.kernel, m.samples, m.written)


@njit(cache=True)
def _wait_for_answer(m, t, h):
    """Sleep until the sample of this tick is answered; return a status.

    A step that waits is no step at work: the mark shows no component meanwhile, so that a supervisor does not count
    the wait as a hang.
    """
    while True:
        found = _read_commands(m)
        if found >= 0:
            return GAVE_UP_STATUS if found == GIVE_UP_TAG else 0
        if not wait_for_entry(m.kernel, m.commands, m.read, m.nap):
            if m.mark != 0:
                carray(integers_at(m.mark), 2)[1] = NO_COMPONENT
            # Python handles signals only in a call of its own
            status = call_step(m.check, (0, t, h, 0, 0))
            if status != 0:
                return status


@step_function(REMOTE_MEMORY)
def remote_step(m, t, h, u, y):
    given, out = carray(u, _MEASURED_WIDTH + m.scale + 3 * m.effort), carray(y, _COMMAND_WIDTH + 2)
    dt, before = h / m.call, m.applied
    if not m.lockstep:
        if _read_commands(m) == GIVE_UP_TAG:
            return GAVE_UP_STATUS
        _watch_commands(m)
    if m.tick % m.period == 0:
        _write_sample(m, given, (m.tick - m.since) * dt if m.applied > 0 else 0.0)
    if m.lockstep:
        status = _wait_for_answer(m, t, h)
        if status != 0:
            return status
    for i in range(_COMMAND_WIDTH):
        out[i] = m.omega_ref[i]
    out[_COMMAND_WIDTH] = (m.tick - m.since) * dt if m.applied > 0 else 0.0
    out[_COMMAND_WIDTH + 1] = m.applied != before
    m.tick += m.call
    return 0


class RemoteController(NativeComponent):
    """Sampled component of a remote controller; `tick` in s, samples every `period` ticks.

    In real time it is called at every tick, because a command should not wait for the next sample. `scale` and
    `effort`: whether the robot measures the force on a scale, and the torques of all motors. `monitored`: whether a
    safety monitor reads the commands.
    """

    def __init__(self, link: RemoteLink, tick: float, period: int, scale: bool, effort: bool, monitored: bool):
        self._link = link
        self._failure: BaseException | None = None
        self._kernel, self._info, self._nap = syscall_numbers(), np.zeros(2, dtype=np.int64), timespec(SLEEP_INTERVAL)
        self._events = np.zeros((MAX_EVENTS, 2), dtype=np.int64)
        self._check = STEP_FUNCTION(lambda *_: self._call_check())
        call = period if link.lockstep else 1
        watchdog = 0 if link.lockstep else round(min(link.watchdog / tick, MAX_TICKS))
        check = ctypes.cast(self._check, ctypes.c_void_p).value
        memory = memory_of(
            REMOTE_MEMORY, kernel=self._kernel.ctypes.data, info=self._info.ctypes.data, nap=self._nap.ctypes.data,
            samples=link.mailbox.samples.address, commands=link.mailbox.commands.address, check=check,
            lockstep=link.lockstep, monitored=monitored, scale=scale, effort=effort, call=call,
            period=period, watchdog=watchdog, events=self._events.ctypes.data,
        )  # fmt: skip
        inputs = (*MEASURED_PORTS, *[SCALE_PORT] * scale, *[EFFORT_PORT] * effort)
        super().__init__("remote", inputs, REMOTE_OUTPUTS, True, remote_step, memory, period=call, keep=self)
        self.finite = not monitored

    def follow(self, deadlines: Deadlines) -> None:
        """Stamp the samples of a paced run with the deadlines of their ticks."""
        self.memory["deadlines"] = deadlines.address

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of samples and commands so far, and of commands replaced before a tick or not finite."""
        m = self.memory[0]
        return {
            "samples_written": int(m["written"]),
            "commands_read": int(m["read"]),
            "superseded": int(m["superseded"]),
            "invalid": int(m["invalid"]),
        }

    def keep_time(self, clock: np.ndarray) -> None:
        self.memory["mark"] = clock.ctypes.data

    def take_messages(self) -> list[tuple[int, str]]:
        m = self.memory[0]
        found = [(tick, EVENT_TEXTS[event]) for tick, event in self._events[: m["event_count"]].tolist()]
        m["event_count"] = 0
        return found

    def lacks_state(self, portable: bool = True) -> str:
        return "is commanded from outside"

    def requests_end(self, status: int) -> bool:
        return status == GAVE_UP_STATUS or isinstance(self._failure, EndRequest)

    def explain(self, status: int) -> str:
        if isinstance(self._failure, EndRequest):
            return str(self._failure)
        if self._failure is not None:
            raise self._failure
        return "got no answer to its sample"

    def _call_check(self) -> int:
        try:
            self._link.check()
        # ctypes prints and drops an exception that leaves a callback, so it is stored for `explain`
        except BaseException as failure:
            self._failure = failure
            return INTERRUPTED_STATUS
        return 0
