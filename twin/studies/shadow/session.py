"""Session of a twin and a robot: wait for topics, follow the samples, record both, and report."""

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import values_by_port
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.process.real_time import real_time
from twin.kernel.process.states import Interrupts
from twin.kernel.recording.logs.column_map import TIME_SIGNAL
from twin.kernel.recording.logs.log import LogError, MappedColumn, refuse_invalid
from twin.kernel.recording.sources.arrival import Arrival, RobotSource
from twin.kernel.recording.sources.signals import MessageReader, WantedSignal
from twin.kernel.recording.sources.stamps import Aligner, Counts, stack_samples
from twin.kernel.recording.writer import ForeignTopic
from twin.robot.plant.dynamics import LONGEST_GAP
from twin.studies.replay.model import RobotModel
from twin.studies.replay.parts import Happening, Rows
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples
from twin.studies.result import count_text
from twin.studies.shadow.alarm import nis_per_count
from twin.studies.shadow.following import Twin
from twin.studies.shadow.layout import OUTPUTS
from twin.studies.shadow.live_view import ShadowViewer
from twin.studies.shadow.mapping import ENCODER_COLUMNS, NS_PER_SECOND
from twin.studies.shadow.receiving import SLICE_TIME, Receiver
from twin.studies.shadow.recording import ShadowRecording
from twin.studies.shadow.sources import waiting_hint
from twin.studies.shadow.text import LINE_WIDTH, shadow_facts, status_line
from twin.studies.shadow.verdict import PLANT_JOINT, SIGNAL_COLUMNS, SessionSummary, gross_disagreement

LINE_PERIOD = 0.25
"""Time between two status lines (s)."""
FLUSH_PERIOD = 0.5
"""Maximum time of recorded data in buffers (s)."""
SILENCE_TIMEOUT = 2.0
"""Time without a sample (s) after which the session reports it."""
HINT_TIMEOUT = 10.0
"""Time of waiting for a topic (s) after which the usual causes are printed."""
JOINT_SEARCH_MESSAGES = 200
"""Number of messages without a joint's name after which the joint is reported as missing."""
MIN_PERIOD_SAMPLES = 100
MAX_LISTED_TOPICS = 6
RATE_CHANGE = 0.1
"""Minimum relative change of the period that is an event."""
LONGEST_STEP = 1e6
"""Maximum step of a clock that was set (s); a larger one is a clock with another epoch."""
MAX_EVENTS_PER_KIND = 1000
"""Maximum number of recorded events per kind, so that bad samples cannot fill the disk."""

RESIDUAL_NAMES = {"residual/force": "force", "residual/joints": PLANT_JOINT, "residual/command": "command"}
"""Topic of a residual -> its name in the summary, without the number of the joint."""

Say = Callable[[str], None]


class Session:
    """Session of twin and robot: it follows a source, records and reports.

    Args:
        columns: columns of the signals; empty if arrivals are readings.
        lateness: budget for late messages (s).
        duration: maximum length (s) by the robot's stamps; infinite for no limit.
        live: whether the source is live, so that silence is an event.
        announce: receives messages that must outlast the status line.
    """

    def __init__(
        self,
        source: RobotSource,
        columns: Mapping[str, MappedColumn],
        wanted: Mapping[str, WantedSignal],
        twin: Twin,
        model: RobotModel,
        lateness: float,
        duration: float,
        live: bool,
        say: Say,
        announce: Say = lambda text: None,
        viewer: ShadowViewer | None = None,
    ):
        self._source, self._columns, self._wanted = source, columns, wanted
        self._twin, self._model, self._live, self._say = twin, model, live, say
        self._duration, self._announce = duration, announce
        self._watched, self._viewer = twin.watched, viewer
        self._happenings: list[Happening] = []
        self._readers: dict[str, MessageReader] = {}
        self._others: list[ForeignTopic] = []
        self._aligner = Aligner(width(INPUTS), list(ENCODER_COLUMNS), lateness, learns_first=not live)
        # a log is fastest in slices; a live robot needs each estimate at once
        self._receiver = Receiver(source, self._readers, self._aligner, twin.state.estimate_at_once if live else None)
        self._recording: ShadowRecording | None = None
        self._before: list[Arrival] = []
        self._events = Counter[str]()
        self._several: dict[str, int] = {}
        self._unread = 0
        self._noted = Counts()
        self._announced = ""
        self._t, self._level = 0.0, math.nan
        self._newest: int | None = None
        self._last_period = math.inf
        self._there = np.zeros(width(INPUTS), dtype=bool)
        self._gross = ""
        self._interrupts = Interrupts()
        self.followed = SessionSummary(source.name)

    def wait_for_topics(self) -> None:
        """Wait for the topics of the column map, and subscribe to each as soon as it is published."""
        by_topic: dict[str, dict[str, MappedColumn]] = {}
        for signal, column in self._columns.items():
            if signal != TIME_SIGNAL:
                by_topic.setdefault(column.name.partition(".")[0], {})[signal] = column
        missing = dict.fromkeys(by_topic)
        begun, hinted = time.monotonic(), False
        while missing:
            seen = self._source.topic_types()
            for topic in [one for one in missing if one in seen]:
                described = self._source.subscribe(topic)
                del missing[topic]
                if described is not None:
                    self._others.append(described)
                    self._readers[topic] = MessageReader(
                        self._source.name, described, by_topic[topic], self._wanted, self._columns.get(TIME_SIGNAL)
                    )
            if missing:
                self._refuse_or_wait(list(missing), seen)
                if not hinted and time.monotonic() - begun > HINT_TIMEOUT:
                    hinted = True
                    self._announce(waiting_hint(self._source.name, list(missing)))

    def _refuse_or_wait(self, missing: list[str], seen: Mapping[str, str]) -> None:
        there = ", ".join(f"{name} ({kind})" for name, kind in list(seen.items())[:MAX_LISTED_TOPICS])
        hint = nearest(missing[0], seen, f"topics here: {there}" if there else "no topics here yet")
        if not self._live:
            raise LogError(f"{self._source.name}: no topic {missing[0]}; {hint}")
        text = f"waiting for {', '.join(missing)}; {hint}"
        if text != self._announced:
            self._announced = text
            self._announce(text)
        self._say(text)
        time.sleep(0.1)

    def follow(self, path: Callable[[], Path]) -> SessionSummary:
        """Follow the robot to the end of source or duration, or Ctrl-C; the first sample calls `path`.

        The second Ctrl-C leaves the recording unfinished.
        """
        # an interrupt in the middle of a slice would lose the rows that are not written yet
        with self._interrupts.listening():
            return self._follow(path)

    def _follow(self, path: Callable[[], Path]) -> SessionSummary:
        if self._live:
            self._receiver.thread.start()
        try:
            with real_time(self._receiver.thread.native_id) if self._live else nullcontext("") as refused:
                self.followed.notes += [refused] if refused else []
                try:
                    self._loop(path)
                finally:
                    self._receiver.stop()
            self._process_slice(end=True)
            if self._interrupts.enough:
                self.followed.notes.append("ended by hand")
            elif not self._live:
                counts = self._aligner.counts
                refuse_invalid(self._source.name, "an encoder", counts.invalid, counts.invalid + counts.samples)
        except BaseException:
            if self._recording is not None:
                self._recording.abandon()
            raise
        self._summarise()
        if self._recording is None:
            raise InputRefused(f"{self._source.name}: {self._why_nothing()}")
        self.followed.recording = self._recording.finish(shadow_facts(self.followed, self._model.name))
        return self.followed

    def _loop(self, path: Callable[[], Path]) -> None:
        self._path = path
        shown = flushed = time.monotonic()
        next_slice, begun = 0.0, math.inf
        while not (self._source.at_end or self._interrupts.enough):
            # time also passes without samples
            if self._t >= self._duration or time.monotonic() - begun - SILENCE_TIMEOUT >= self._duration:
                break
            if self._live:
                # arrivals in between form one slice
                next_slice = max(next_slice + SLICE_TIME, time.monotonic())
                time.sleep(max(0.0, next_slice - time.monotonic()))
            else:
                self._receiver.receive_once()
            sampled, now = self._process_slice(), time.monotonic()
            if self._live and self._recording is not None:
                begun = min(begun, now)
            self._note_silence(sampled)
            if now - shown >= LINE_PERIOD:
                shown = now
                self._watch_publishers()
                line = self.line()
                self._say(line)
                if self._viewer:
                    self._viewer.say(line)
            if now - flushed >= FLUSH_PERIOD and self._recording is not None:
                flushed = now
                self._recording.flush()

    def _process_slice(self, end: bool = False) -> bool:
        """Process one slice of samples: rows, recording and live view. Return whether samples have arrived."""
        if self._viewer and (text := self._viewer.press()):
            self._record_event("accepted", text)
        received = self._receiver.drain(end)
        arrivals, samples = received.arrivals, received.samples
        if self._recording is None:
            self._before += arrivals
            if not samples:
                self._refuse_lacking()
                return False
            arrivals, self._before = self._before, []
        times, values = (
            stack_samples(samples) if samples else (np.empty(0, dtype=np.int64), np.empty((0, width(INPUTS))))
        )
        rows: Rows = {}
        if samples:
            found = RobotSamples(times / NS_PER_SECOND, values)
            rows = self._twin.feed(found)
            self._t = float(found.t[-1])
            self._there |= np.isfinite(values).any(axis=0)
            self._add_residuals(found.t, rows)
        if self._recording is None:
            first = samples[0]
            self._recording = ShadowRecording(
                self._path(), self._twin.topics, self._others, self._model, self._source.name,
                (self._aligner.base, first.arrived),
            )  # fmt: skip
        if received.unread:
            count = count_text(len(received.unread), "message")
            self._record_event("message", f"{count} unreadable: {received.unread[-1]}")
            if not self._unread:
                self._announce(received.unread[0])
            self._unread += len(received.unread)
        self._recording.write(arrivals, times, self._twin.rows_to_record(rows))
        if received.late:
            late, most = count_text(len(received.late), "estimate"), 1e3 * max(received.late)
            self._record_event("deadline", f"{late} later than a period after the sample, by {most:.3g} ms at most")
        self._note_happenings()
        if self._viewer:
            self._viewer.show(times, rows, self._happenings)
            self._happenings = []
        return bool(samples)

    def _add_residuals(self, t: NDArray[np.float64], rows: Rows) -> None:
        residuals = self.followed.residuals
        for topic, name in RESIDUAL_NAMES.items():
            for i, column in enumerate(rows[topic].T if topic in rows else ()):
                residuals[name if rows[topic].shape[1] == 1 else f"{name} {i + 1}"].add(t, column)
        y = values_by_port(OUTPUTS, rows["shadow"])
        residuals["NIS"].add(t, np.where(y["moves"] > 0.0, nis_per_count(y["NIS"], y["used"]), math.nan))
        self.followed.map_error = self._twin.check.map_error
        if not self._gross and (found := gross_disagreement(residuals, self.followed.map_error)):
            self._gross = found.text
            self._record_event("gross", found.text, float(t[-1]))
            self._announce(f"{self._source.name}: {found.text}")
        if "alarm" in rows:
            self._level = float(rows["alarm"][-1, 0])

    def _note_happenings(self) -> None:
        for one in self._twin.happenings():
            self._record_event(one.text[:20], one.text, one.t)
        with self._receiver.lock:
            gaps, self._aligner.gaps = self._aligner.gaps, []
            noted, now = self._noted, replace(self._aligner.counts)
        for start, end in gaps:
            # single lost samples are only counted, so that they do not fill the list of events
            if end - start > LONGEST_GAP * 1e9:
                self._record_event("gap", f"no samples for {(end - start) / 1e9:.3g} s", end / 1e9)
        if now.restarts > noted.restarts:
            step = self._aligner.clock_step
            what = f"was set by {step:+.3f} s" if abs(step) < LONGEST_STEP else "has restarted"
            self._record_event("restart", f"the robot's clock {what}; time continues by arrivals")
        period, before = self._aligner.period, self._last_period
        if period < math.inf == before:
            self._last_period = period
        elif period < math.inf and abs(period - before) >= RATE_CHANGE * before:
            self._record_event("rate", f"the rate has changed from {1e9 / before:.4g} to {1e9 / period:.4g} Hz")
            self._last_period = period
            if self._watched:
                self._watched.change_rate(self._t, 1e9 / period)
        if now.invalid > noted.invalid:
            new = now.invalid - noted.invalid
            self._record_event("invalid", f"{new} samples with NaN or infinity in an encoder; they are left out")
        self._noted = now

    def _note_silence(self, sampled: bool) -> None:
        """Report the missing topic or joint after `SILENCE_TIMEOUT` without a sample, and suspend the alarm."""
        if sampled or self._newest is None:
            if sampled or self._live or self._receiver.heard:
                self._newest, self.followed.silent = self._source.now_ns(), ""
            return
        if self.followed.silent or self._source.now_ns() - self._newest <= SILENCE_TIMEOUT * 1e9:
            return
        self.followed.silent = self._why_silent()
        text = f"no sample for {SILENCE_TIMEOUT:g} s: {self.followed.silent}"
        self._record_event("silence", text)
        self._announce(f"{self._source.name}: {text}")
        if self._watched:
            self._watched.lose(self._t, text)

    def _why_silent(self) -> str:
        """Find the cause of a silence of the robot: a missing topic, a missing joint, or values that are not finite."""
        since = self._source.now_ns() - SILENCE_TIMEOUT * 1e9
        columns = {signal: column.name for signal, column in self._columns.items() if signal != TIME_SIGNAL}
        encoders = [signal for signal in columns if self._wanted[signal].column in ENCODER_COLUMNS]
        for topic in sorted({columns[signal].partition(".")[0] for signal in encoders}):
            if self._receiver.heard.get(topic, 0) < since:
                count = count_text(self._source.publisher_count(topic), "publisher")
                return f"nothing has come of {topic}, which has {count}" if self._live else f"nothing comes of {topic}"
        lacking = self._aligner.lacking
        names = [name for signal, name in columns.items() if self._wanted[signal].column in lacking]
        if names:
            return f"no message has {', '.join(names[:MAX_LISTED_TOPICS])}"
        return "the encoders' values are not finite" if self._receiver.heard else "nothing has come"

    def _watch_publishers(self) -> None:
        """Report topics with more than one publisher, which may contradict each other."""
        for topic in self._readers if self._live else ():
            count = self._source.publisher_count(topic)
            if count > max(1, self._several.get(topic, 1)):
                self._several[topic] = count
                text = f"{count} publishers on {topic}; samples of equal stamps are put together"
                self._record_event("publishers", text)

    def _record_event(self, kind: str, text: str, t: float | None = None) -> None:
        self._events[kind] += 1
        if self._recording is not None and self._events[kind] <= MAX_EVENTS_PER_KIND:
            one = Happening(self._t if t is None else t, text)
            self._recording.event(one)
            self._happenings += [one] if self._viewer else []

    def _refuse_lacking(self) -> None:
        """Reject messages without a needed joint, before the first sample."""
        if len(self._before) < JOINT_SEARCH_MESSAGES:
            return
        if sentences := self._missing_signals():
            raise LogError("\n".join(sentences))
        # keep only recent messages from before the first sample
        del self._before[:-JOINT_SEARCH_MESSAGES]

    def _missing_signals(self) -> list[str]:
        return [text for reader in self._readers.values() for text in reader.missing_signals()]

    def _why_nothing(self) -> str:
        if sentences := self._missing_signals():
            return sentences[0]
        if invalid := self._aligner.counts.invalid:
            return f"{invalid} samples, all with NaN or infinity in an encoder; expected numbers"
        return "not one sample with all six angles came"

    def _summarise(self) -> None:
        one, aligner = self.followed, self._aligner
        one.seconds, one.counts, one.period = self._t, aligner.counts, aligner.period / 1e9
        one.lateness, one.offset, one.drift = aligner.clocks.lateness, aligner.clocks.offset, aligner.clocks.drift
        one.in_hand, one.missed = self._receiver.in_hand, self._receiver.missed
        one.dropped = self._source.drop_count
        if self._unread:
            one.notes.append(f"{count_text(self._unread, 'message')} could not be read")
        one.measured_signals = [name for name, place in SIGNAL_COLUMNS.items() if self._there[place].any()]
        if self._watched:
            one.changes = None if self._watched.why_not else self._watched.changes
            one.no_alarm = self._watched.why_not
            one.notes += self._watched.proposals
        one.notes += [
            f"{topic} has no stamps: its times of arrival are taken, so that their jitter is an error of time"
            for topic, reader in self._readers.items()
            if not reader.stamped
        ]
        if aligner.counts.unmatched:
            one.notes.append(
                f"{count_text(aligner.counts.unmatched, 'incomplete sample')} before the first complete one left out: "
                "topics are matched once their periods are known"
            )
        if aligner.counts.samples > MIN_PERIOD_SAMPLES and math.isinf(aligner.period):
            one.notes.append("stamps have no regular interval; missing samples cannot be counted")
        one.notes += [f"{count} publishers on {topic}" for topic, count in self._several.items()]

    def line(self) -> str:
        counts, period = self._aligner.counts, self._aligner.period
        if self.followed.silent and self._newest is not None:
            quiet = (self._source.now_ns() - self._newest) / 1e9
            return f"{self._t:.1f} s  no sample for {quiet:.0f} s: {self.followed.silent}"[:LINE_WIDTH]
        NIS = self.followed.residuals.get("NIS")
        # a robot at rest has no NIS
        recent = NIS.recent if NIS and self._t - NIS.last < 1.0 else math.nan
        late = self._aligner.clocks.lateness.quantile(0.99)
        return status_line(self._t, 1e-9 * period, late, counts, recent, self._level, self._joints())

    def _joints(self) -> float:
        """Return the largest recent residual of a joint of the plant model, rad; NaN before the first residual."""
        found = [abs(r.recent) for name, r in self.followed.residuals.items() if name.startswith(PLANT_JOINT)]
        return max(found, default=math.nan)
