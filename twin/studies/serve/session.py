"""Session of a served robot: the process of its topics, the run, both sides in one recording."""

import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.deadlines import Deadlines
from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.port import width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused, SafetyTrip
from twin.kernel.process.black_box import exit_phrase
from twin.kernel.process.guard import POLL_INTERVAL, JobFailure, raise_failure
from twin.kernel.process.job import JobLimits, recording_status
from twin.kernel.process.mailbox import OBEYED_TAG, Mailbox
from twin.kernel.process.process import GuardedProcess
from twin.kernel.process.real_time import SOURCE_PRIORITY, real_time
from twin.kernel.process.reporter import Reporter
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.recorder import Recorder
from twin.robot.assembly.build import have_effort, planned_drives
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.live.runs import live_server, record_run, run_facts
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS, RemoteController, RemoteLink
from twin.robot.run.cost import refuse_endless
from twin.robot.run.trace import Trace
from twin.studies.check import baseline as stored
from twin.studies.check.job import stored_baseline

WIRE_JOB = "twin.studies.serve.exchange:exchange"
WATCHDOG_PERIODS = 5.0
"""Default time of the watchdog, in periods of the controller."""
FLUSH_INTERVAL, LOCKSTEP_FLUSH_INTERVAL = 0.5, 0.1
"""Simulated time (s) between two writes of all recorded data to the file; lockstep may take longer than real time."""
CLOSE_TIMEOUT = 3.0
"""Timeout (s) for the process of the topics to end by itself."""
COMMANDS_TOPIC = Topic(
    "commands",
    (
        Field("omega_ref", 3, "double", "rad/s", "motor speeds of a command, as they arrived"),
        Field("number", 1, "int", "1", "number of the command"),
        Field("answers", 1, "int", "1", "tick that it answers; -1 for no tick"),
        Field("obeyed", 1, "bool", "1", "whether it was passed on to the robot"),
    ),
    1,
)
"""Recorded topic of a remote controller's commands, at their times of arrival; in lockstep at the ticks they answer."""
COUNTED_TEXTS = {
    "superseded": "replaced before a tick", "invalid": "not a number", "unanswered": "samples without an answer",
    "lost": "samples lost", "unwritten": "messages not written", "resent": "samples repeated",
}  # fmt: skip
"""Counts of `ServedRobot.facts` that the text of a run states if they are not 0."""
MIN_COMMAND_GAP = 1e-6
"""Minimum distance (ticks) between recorded commands: 1 ns for a tick of 1 ms."""


@dataclass(frozen=True)
class ServeOptions:
    """Options of a served robot.

    Attributes:
        lockstep: whether each sample waits for its answer.
        answer_s: time (s) without an answer after which a run in lockstep ends.
        commands: message type of commands: "joint" or "array".
        command_topic: topic of the commands; "" for the usual one of the type.
        watchdog, silence: see `RemoteLink`.
        names: joint names: motors 1 to 3, then links 1 to 3.
        domain: DDS domain; None for that of ROS_DOMAIN_ID.
    """

    lockstep: bool
    answer_s: float
    commands: str
    command_topic: str
    watchdog: float
    silence: float
    names: tuple[str, ...]
    domain: int | None


class WireProcess:
    """The process that publishes samples and receives commands; a context manager that ends it.

    Attributes:
        events: events (tick, or -1 for the present one; text) to be recorded.
        summary: facts about the exchange, once the process has ended.
    """

    def __init__(self, say: Callable[[str], None]):
        self._say, self._process, self._ready = say, GuardedProcess(WIRE_JOB), False
        self.mailbox = Mailbox(self._process.box.fd, width(SAMPLE_PORTS), width(COMMAND_PORTS))
        self.events: list[tuple[int, str]] = []
        self.summary: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self._process.close()

    def start(self, settings: Mapping[str, Any]) -> None:
        """Start the exchange and wait until the run may begin."""
        self._process.start({"settings": dict(settings)})
        while not self._ready:
            self.poll(POLL_INTERVAL)

    def poll(self, wait: float = 0.0) -> None:
        """Take the reports of the process, after waiting at most `wait` (s) for one; raise its error if it failed."""
        for report in self._process.reports(wait):
            raise_failure(report)
            note = report.get("note", {})
            if "waiting" in note:
                self._say(note["waiting"])
            if "event" in note:
                self.events.append((note["tick"], note["event"]))
            self._ready |= bool(note.get("ready"))
            self.summary = report.get("finished", self.summary)
        if self._process.gone and not self.summary:
            how, (*_, printed) = exit_phrase(self._process.end()), ["", *self._process.output_tail.strip().splitlines()]
            raise JobFailure(f"the process of the topics {how}{f'; it printed: {printed}' if printed else ''}")

    def finish(self) -> None:
        """End the exchange, and wait for its summary."""
        self.mailbox.close()
        deadline = time.monotonic() + CLOSE_TIMEOUT
        while not self.summary and time.monotonic() < deadline:
            self.poll(POLL_INTERVAL)


class ServedRobot(Observer):
    """Remote side of a served run, see `RemoteSide`, and its observer: it records commands and events of the wire.

    Ctrl-C and SIGTERM end the run regularly.

    Args:
        trace: observer that keeps the signals; None for none.

    Attributes:
        enough: whether Ctrl-C or SIGTERM ended the run.
    """

    enough = False

    def __init__(self, wire: WireProcess, options: ServeOptions, trace: Trace | None = None):
        self._wire, self._trace = wire, trace
        self.link = RemoteLink(wire.mailbox, options.lockstep, options.watchdog, options.silence, self._check)
        self.topics: Sequence[Topic] = [COMMANDS_TOPIC]
        limits = {"watchdog_s": f"{options.watchdog:g}", "silence_s": f"{options.silence:g}"}
        times = {} if options.lockstep else limits
        self._flush_interval = LOCKSTEP_FLUSH_INTERVAL if options.lockstep else FLUSH_INTERVAL
        mode = "lockstep" if options.lockstep else "real time"
        self.metadata: Mapping[str, str] = {"mode": mode, **times, "irregular": COMMANDS_TOPIC.name}
        self._newest, self._flushed = 0.0, 0

    def observers(self, recorder: Recorder, deadlines: Deadlines | None) -> Sequence[Observer]:
        """Return the observers of the run."""
        self._recorder, self._deadlines = recorder, deadlines
        return [self, *([self._trace] if self._trace else [])]

    def begin(self, simulation: Simulation) -> None:
        self._simulation, self._tick = simulation, simulation.system.tick
        remote = simulation.system.component("remote")
        assert isinstance(remote, RemoteController)
        self._remote = remote
        if self._deadlines:
            remote.follow(self._deadlines)
        # replaces the handlers of the run, which would leave the recording unfinished; the run restores the first ones
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, self._stop)

    @property
    def answer_error(self) -> str:
        """Error message of a run in lockstep that ended without an answer; "" for another end."""
        failure = self._simulation.failure
        return str(failure) if isinstance(failure, EndRequest) and not self.enough else ""

    @property
    def facts(self) -> dict[str, Any]:
        """Facts about the exchange: mode, counts of both sides."""
        return {**self.metadata, **self._remote.counts, **self._wire.summary}

    def ready(self, tick: int) -> None:
        # the recorder comes after this observer, and has all rows before `tick` only now
        if tick - self._flushed >= round(self._flush_interval / self._tick):
            self._flushed = tick
            self._recorder.call(lambda writer: writer.flush())

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        # in lockstep the wire reports before it answers, so that events of this slice have arrived
        self._wire.poll()
        last = max(first, first + len(rows) - 1)
        for tick, text in self._wire.events:
            events.append(TickEvent(min(max(tick, first), last) if tick >= 0 else last, "WARNING", text, "wire"))
        self._wire.events.clear()
        events.sort(key=lambda event: event.tick)
        heads, speeds = self._wire.mailbox.commands.pop_arrays()
        if len(heads):
            self._record(heads, speeds, last)

    def _record(self, heads: NDArray[np.int64], speeds: NDArray[np.float64], last: int) -> None:
        numbers, ticks, written, tags = heads.T
        times = np.where(ticks >= 0, ticks, last).astype(float)
        if self._deadlines:
            pace = self._deadlines.memory[0]
            times = (written - int(pace["begun"])) / float(pace["tick"])
        gaps = MIN_COMMAND_GAP * np.arange(1, len(times) + 1)
        times = gaps + np.maximum.accumulate(np.maximum(times - gaps, self._newest))
        self._newest = float(times[-1])
        rows = np.column_stack([speeds, numbers, ticks, tags == OBEYED_TAG])
        self._recorder.call(lambda writer: writer.write_at(COMMANDS_TOPIC.name, times, rows))

    def _check(self) -> None:
        self._wire.poll()
        if self.enough:
            raise EndRequest("waited for an answer when it was ended by hand")

    def _stop(self, number: int, frame: Any) -> None:
        if self.enough:
            raise KeyboardInterrupt
        self.enough = True


def served_run(
    reporter: Reporter,
    experiment: str,
    settings: Sequence[str],
    drive: str | None,
    body: str | None,
    out: str | None,
    options: Mapping[str, Any],
    isolate_drives: bool = False,
    limit_step: float = JobLimits.step,
    check: bool = False,
    accept: str = "",
    baselines: str | None = None,
    sure: bool = False,
    live: Mapping[str, Any] | None = None,
    results: str = "results",
) -> dict[str, Any]:
    """Serve the robot of an experiment to a remote controller, as the job of `twin serve`.

    Notes: {"line": text for the user}; those of `recorded_runs`; the fields of the run have `served` in addition.

    Args:
        experiment, settings, drive, body, out, isolate_drives, limit_step, sure: see `recorded_runs`.
        options: fields of `ServeOptions`; a watchdog of None is `WATCHDOG_PERIODS`.
        check: whether to compare the measures with their baseline, in the folder `baselines`.
        accept: reason for which they become the baseline instead; "" to leave it as it is.
        live: port and origins of a live server; None for none.

    Returns:
        {"text": comparison with the baseline, "" without one; "exit_code": 1 if a measure deviates, else 0}.

    Raises:
        InputRefused: the experiment has errors, no baseline, or the network is unusable.
        ComponentFailed: a component failed, or the controller did not answer; then the recording is whole.
        SafetyTrip: the monitor tripped in an experiment without faults.
        KeyboardInterrupt: Ctrl-C; the recording is whole.
    """
    asked, loaded = ServeOptions(**options), load_experiment(Path(experiment), settings, drive, body)
    if options["watchdog"] is None:
        asked = replace(asked, watchdog=WATCHDOG_PERIODS * loaded.controller_ticks * loaded.cosim.tick)
    factor = None if asked.lockstep else 1.0
    if not sure:
        refuse_endless([loaded], factor)
    baseline, file, named = None, experiment_file(Path(experiment)), drive or stored.OWN_DRIVE
    # absolute, as an FMU may change the working directory
    folder = (Path(baselines) if baselines else stored.baseline_folder_of(file, update=False)).absolute()
    trace = Trace() if check or accept else None
    # a missing or damaged baseline is refused before anything is served
    if check:
        baseline = stored_baseline(folder, file, named)
    elif accept:
        baseline = stored.known_baseline(folder, file.stem, named)

    def say(text: str) -> None:
        reporter.note(line=text)

    with ExitStack() as stack:
        wire = stack.enter_context(WireProcess(say))
        wire.start(wire_settings(loaded, asked))
        robot = ServedRobot(wire, asked, trace)
        if not asked.lockstep and (refused := stack.enter_context(real_time(priority=SOURCE_PRIORITY))):
            say(refused)
        viewer = stack.enter_context(live_server(say, waits=False, **live)) if live else None
        try:
            run = record_run(
                reporter, loaded, out, isolate_drives, limit_step, results, factor=factor, viewer=viewer, remote=robot
            )
        except ComponentFailed:
            # a wait before the first row that was ended by hand
            if robot.enough:
                raise KeyboardInterrupt from None
            raise
        wire.finish()
    done: dict[str, Any] = {"text": "", "exit_code": 0}
    served = robot.facts
    if trace and not robot.enough and not robot.answer_error:
        accepted = accept and (loaded.faults or not run.trip)
        store = stored.baseline_file(folder, file.stem, named) if accepted else None
        done, served["check"] = _compare(loaded, named, baseline, trace, store, accept)
    facts = run_facts(loaded, run)
    reporter.note(run=facts | {"served": {"lines": exchange_lines(served), "facts": served}})
    if robot.enough:
        raise KeyboardInterrupt
    if robot.answer_error:
        raise ComponentFailed(f"{robot.answer_error}\n{recording_status(run.recording.parent)}")
    if run.trip and not loaded.faults:
        raise SafetyTrip(f"{loaded.name}: {run.trip}")
    return done


def wire_settings(experiment: Experiment, options: ServeOptions) -> dict[str, Any]:
    """Return the settings of the process of the topics, see `exchange`."""
    return asdict(options) | {
        "tick_s": experiment.cosim.tick,
        "counts_m": experiment.plant.motor_counts_per_turn,
        "counts_l": experiment.plant.joint_counts_per_turn,
        "has_effort": have_effort(planned_drives(experiment)),
        "has_scale": experiment.scale is not None,
    }


def exchange_lines(facts: Mapping[str, Any]) -> list[str]:
    """Format the facts about the exchange of a served run as lines."""
    # a process of the topics that was ended has no summary
    commands = facts.get("commands", facts["commands_read"])
    counts = [f"{facts['samples_written']} samples", f"{commands} commands"]
    for key, text in COUNTED_TEXTS.items():
        counts += [f"{facts[key]} {text}"] if facts.get(key) else []
    counts += [f"{count} {reason}" for reason, count in facts.get("ignored", {}).items() if count]
    lines = [f"{facts['mode']}: {', '.join(counts)}"]
    if latency := facts.get("latency_ms"):
        p50, p99, largest = (latency[key] for key in ("p50", "p99", "largest"))
        lines.append(
            f"from a command to the sample it moved {p50:.2f} ms, {p99:.2f} ms at 99 %, at most {largest:.2f} ms"
        )
    return [*lines, *facts.get("notes", ())]


def _compare(
    experiment: Experiment, drive: str, baseline: stored.Baseline | None, trace: Trace, store: Path | None, reason: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Compare a completed run with its baseline. Return (text and exit code, facts).

    A measure that is undefined for this run deviates, since the baseline has a value.

    Args:
        store: baseline file to be replaced by the run's measures for `reason`; None to replace none.
    """
    from twin.kernel.serialise import to_dict
    from twin.robot.assembly.roles import third_party_parts
    from twin.studies.check.measurement import measure_signals, recorded_signals
    from twin.studies.check.text import check_result
    from twin.studies.check.verdict import verdict
    from twin.studies.result import render_text

    signals = recorded_signals(experiment, trace, planned_drives(experiment), third_party_parts(experiment))
    try:
        now = measure_signals(experiment, signals)
    except InputRefused as undefined:
        return {"text": f"Deviates: {undefined}", "exit_code": 1}, {"undefined": str(undefined)}
    found = verdict(experiment, drive, baseline, now)
    text = render_text(check_result([found], []))
    if store is None:
        return {"text": text, "exit_code": int(bool(found.deviations))}, to_dict(found)
    if after := stored.accepted_text(experiment, drive, now, baseline, date.today().isoformat(), reason):
        stored.write_baseline(store, after)
        text += f"\n  written    {store}"
    return {"text": text, "exit_code": 0}, to_dict(found)
