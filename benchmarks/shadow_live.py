"""A twin beside a robot in wall time: how soon it has an estimate, what it costs, what a stall does, and replay.

    python -m benchmarks.shadow_live [--blocks 10] [--block-s 10] [--long-s 60]

`make bench` runs it with fewer and shorter blocks. The robot is another process, which says its six angles and its
three commands 1000 times a second by DDS on the loopback, with stamps of its plan, and how late it is (s) in place of a
force. `--long-s 600` is the promise of ten minutes.
"""

import argparse
import gc
import math
import os
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from subprocess import PIPE, Popen
from typing import Any

import numpy as np

from benchmarks.measurement import Measurement
from twin.kernel.process.real_time import real_time
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.sources.arrival import Arrival, RobotSource
from twin.kernel.recording.sources.playback import Playback
from twin.kernel.recording.sources.signals import Reading
from twin.kernel.recording.sources.stamps import Sample
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.replay.model import model_of
from twin.studies.replay.sample_columns import F_Z
from twin.studies.replay.samples import samples_of
from twin.studies.shadow.ahead import SessionBranches
from twin.studies.shadow.alarm import CHANNELS, Tolerances
from twin.studies.shadow.following import AlarmWatch, twin_of
from twin.studies.shadow.mapping import wanted_signals
from twin.studies.shadow.session import Session, SessionSummary

RATE = 1000.0
DOMAIN = 87
TOPIC = "/joint_states"
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>20</MaxAutoParticipantIndex><Peers><Peer Address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)
MAPS = [f"estimator.theta_{side}[{i}]={TOPIC}.position.{side}{i + 1}" for side in "ml" for i in range(3)]
COMMANDS = [f"controller.omega_ref[{i}]={TOPIC}.velocity.m{i + 1}" for i in range(3)]
LATE = f"scale.F_z={TOPIC}.effort.m1[N]"
STALL = 2.0
CAUGHT_UP = 0.005
"""s from stamp to estimate, as after no stall."""
SETTLED = 2.0
"""s of a block that are not counted: discovery, and the period that is not known yet."""


def publish(path: str) -> None:
    """The robot: angles and speeds of the array at `path` (n, 9), over and over."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    from tests.studies.shadow.player import JOINTS, JointState, joint_state

    rows = np.load(path).tolist()
    participant = DomainParticipant(DOMAIN)
    qos = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(10))
    writer: Any = DataWriter(participant, Topic(participant, f"rt{TOPIC}", JointState), qos=qos)
    # a robot has a computer of its own
    with real_time():
        begun, since, k = time.monotonic(), time.time_ns(), 0
        while True:
            time.sleep(max(0.0, begun + k / RATE - time.monotonic()))
            row, ns = rows[k % len(rows)], since + round(k * 1e9 / RATE)
            late = [1e-9 * (time.time_ns() - ns)] * 6
            writer.write(joint_state(ns, JOINTS, row[:6], [*row[6:], 0.0, 0.0, 0.0], late))
            k += 1


def bare(seconds: float) -> list[float]:
    """Times (s) from stamp to the decoded message, of a receiver that does nothing else, with the library alone."""
    from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from twin.kernel.recording.sources.ros_types import idl_class

    participant = DomainParticipant(DOMAIN)
    qos = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(10_000))
    reader: Any = DataReader(
        participant, Topic(participant, f"rt{TOPIC}", idl_class("sensor_msgs/msg/JointState")), qos=qos
    )
    waiting = WaitSet(participant)
    condition = ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Any)
    waiting.attach(condition)
    found: list[float] = []
    with real_time():
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            waiting.wait(10**8)
            for one in reader.take(500):
                stamp = one.header.stamp
                found.append(1e-9 * (time.time_ns() - stamp.sec * 10**9 - stamp.nanosec) - one.effort[0])
    return found[round(SETTLED * RATE) :]


class Beside:
    """Sessions beside the robot of an experiment, with everything that a session has.

    Args:
        experiment: of the robot.
        predicts: whether they predict, too.
    """

    def __init__(self, experiment: Experiment, predicts: bool = True):
        self.experiment, self.model, self._predicts = experiment, model_of(experiment), predicts
        self._ahead: SessionBranches | None = None
        self.latencies: list[float] = []
        self.when: list[float] = []

    def session(self, source: RobotSource, seconds: float, live: bool = True) -> Session:
        belief = self.model.belief
        # what is no news plays no role for the time
        limits = Tolerances(dict.fromkeys(CHANNELS, 1.0), dict.fromkeys(CHANNELS, 1.0))
        self.close()
        self._ahead = SessionBranches(self.experiment) if self._predicts else None
        ahead = self._ahead.predicting_part if self._ahead else None
        twin = twin_of(self.experiment, self.model, source.name, AlarmWatch({500.0: limits}, 0.01), ahead=ahead)
        columns = column_map([*MAPS, *COMMANDS, LATE]) if live else {}
        made = Session(
            source, columns, wanted_signals(belief), twin, self.model, 0.03, seconds, live, lambda text: None
        )
        estimate, aligner, latencies, when = made._receiver._estimate, made._aligner, self.latencies, self.when

        def timed(sample: Sample) -> None:
            assert estimate is not None
            estimate(sample)
            latencies.append(1e-9 * (time.time_ns() - aligner.base - sample.t) - sample.row[F_Z.start])
            when.append(time.monotonic())

        latencies.clear()
        when.clear()
        made._receiver._estimate = timed if live else None
        return made

    def follow(self, source: RobotSource, seconds: float, live: bool = True) -> SessionSummary:
        session = self.session(source, seconds, live)
        session.wait_for_topics()
        with tempfile.TemporaryDirectory() as folder:
            followed = session.follow(lambda: Path(folder) / "run.mcap")
        source.close()
        return followed

    def close(self) -> None:
        """Free the FMUs of the last session's predictions."""
        if self._ahead:
            self._ahead.__exit__()
        self._ahead = None

    def block(self, seconds: float) -> list[float]:
        """Times (s) from stamp to estimate."""
        self.follow(robot(), seconds)
        # what came while the session was made is worked off first
        begun = next(k for k, late in enumerate(self.latencies) if late < CAUGHT_UP)
        return self.latencies[max(begun, round(SETTLED * RATE)) :]


def robot() -> RobotSource:
    from twin.kernel.recording.sources.dds import DdsSource

    return DdsSource(f"ros2:{TOPIC}")


def stalled() -> RobotSource:
    """The robot, of which nothing is taken for a time in the middle."""
    from twin.kernel.recording.sources.dds import DdsSource

    class Stalled(DdsSource):
        begun = math.inf

        def receive(self, wait: float) -> list[Arrival]:
            self.begun = min(self.begun, time.monotonic())
            if time.monotonic() - self.begun > SETTLED + 1.0:
                self.begun = -math.inf
                time.sleep(STALL)
                self.begun = math.nan
            return super().receive(wait)

    return Stalled(f"ros2:{TOPIC}")


def resident() -> float:
    """Memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def in_wall_time(beside: Beside, blocks: int, block: float, long: float) -> list[Measurement]:
    """Beside the robot, which is there."""
    # compiles, and fills caches
    beside.block(SETTLED + 1.0)
    ratios, p99 = [], []
    for _ in range(blocks):
        alone, twin = (np.quantile(one(block + SETTLED), 0.99) for one in (bare, beside.block))
        ratios.append(float(twin / alone))
        p99.append(float(twin))
        gc.collect()
    print(f"  p99 from stamp to estimate {1e3 * median(p99):.3g} ms; ratios {', '.join(f'{x:.2f}' for x in ratios)}")
    memory: list[float] = []

    def say(text: str) -> None:
        memory.append(resident())

    session = beside.session(robot(), long)
    session._say = say
    # times of each of 600,000 samples would be memory that no session has
    session._receiver._estimate = session._twin.state.estimate_at_once
    session.wait_for_topics()
    wall, used = time.monotonic(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        followed = session.follow(lambda: Path(folder) / "run.mcap")
    share = (time.process_time() - used) / (time.monotonic() - wall)
    session._source.close()
    lost = followed.counts.missing + followed.counts.late + followed.counts.incomplete - followed.dropped
    third = max(1, len(memory) // 3)
    growth = median(memory[-third:]) / median(memory[third : 2 * third])
    hand = followed.in_hand
    held = beside.follow(stalled(), SETTLED + STALL + 6.0)
    late, when = np.array(beside.latencies), np.array(beside.when)
    first = int(np.argmax(late))
    caught_up = when[first + np.argmax(late[first:] < CAUGHT_UP)] - when[first]
    remark = "; ".join(note for note in followed.notes if note.startswith("not in real time"))
    name = "shadow at 1 kHz:"
    return [
        Measurement(f"{name} p99 / a bare receiver's", median(ratios), "", 1.5, remark=remark),
        Measurement(f"{name} in hand, p99", 1e3 * hand.quantile(0.99), "ms", 0.3, remark=remark),
        Measurement(f"{name} in hand, p99.9", 1e3 * hand.quantile(0.999), "ms"),
        Measurement(f"{name} in hand, longest", 1e3 * hand.largest, "ms"),
        Measurement(f"{name} later than 1 ms, of 1000", 1e3 * followed.missed / max(1, hand.count), ""),
        Measurement(f"{name} lost in {long:g} s", float(lost), "", 0.0),
        Measurement(f"{name} share of a core", 100.0 * share, "%", 60.0),
        Measurement(f"{name} memory, last third / middle one", growth, "", 1.02),
        Measurement(f"{name} caught up after 2 s", float(caught_up), "s", 2.0),
        Measurement(f"{name} lost in that", float(held.counts.missing), "", 0.0),
    ]


def replayed(beside: Beside, what: str, least: float, times: int = 5) -> Measurement:
    """Decoded samples of the experiment at 500 Hz, as fast as they go, recorded."""
    samples = samples_of(run_in_memory(beside.experiment, beside.experiment.controller_ticks))
    samples.u[:, 9:] = np.nan
    columns = tuple(range(samples.u.shape[1]))
    arrivals = [
        Arrival("encoders", t, Reading(t, columns, tuple(row)))
        for t, row in zip(np.rint(samples.t * 1e9).astype(int).tolist(), samples.u.tolist(), strict=True)
    ]
    speeds = []
    for _ in range(times):
        began = time.perf_counter()
        beside.follow(Playback("log", readings=arrivals, speed=0.0), math.inf, live=False)
        speeds.append(float(samples.t[-1]) / (time.perf_counter() - began))
    beside.close()
    return Measurement(f"shadow: log at 500 Hz, {what}, times real time", median(speeds[1:]), "", None, least)


def measurements(path: Path, blocks: int = 3, block: float = 4.0, long: float = 15.0) -> list[Measurement]:
    """Of the experiment at `path`."""
    beside, plain = Beside(load_experiment(path)), Beside(load_experiment(path), predicts=False)
    found = [replayed(plain, "recorded", 50.0), replayed(beside, "predicting, too", None)]
    if find_spec("cyclonedds") is None:
        return [*found, Measurement("shadow at 1 kHz", None, "", remark="cyclonedds not installed")]
    run = run_in_memory(beside.experiment, beside.experiment.controller_ticks)
    names = "estimator.theta_m", "estimator.theta_l", "controller.omega_ref"
    os.environ |= {"CYCLONEDDS_URI": LOOPBACK, "ROS_DOMAIN_ID": str(DOMAIN)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.npy"
        # there and back, so that it does not jump; at twice the pace
        rows = np.hstack([run[name] for name in names])
        np.save(file, np.vstack([rows, rows[::-1]]))
        with Popen([sys.executable, "-m", "benchmarks.shadow_live", "--publish", str(file)], stdout=PIPE) as publisher:
            try:
                return [*found, *in_wall_time(beside, blocks, block, long)]
            finally:
                beside.close()
                publisher.kill()


def main() -> int:
    from benchmarks.__main__ import EXPERIMENT, closing, line

    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--blocks", type=int, default=10, help="pairs of blocks: bare receiver, twin")
    asked.add_argument("--block-s", type=float, default=10.0)
    asked.add_argument("--long-s", type=float, default=60.0, help="the run for losses, processor and memory")
    asked.add_argument("--publish", help=argparse.SUPPRESS)
    given = asked.parse_args()
    if given.publish:
        publish(given.publish)
    found = measurements(EXPERIMENT, given.blocks, given.block_s, given.long_s)
    print("\n".join(line(one) + (f"  ({one.remark})" if one.remark else "") for one in found))
    text, code = closing(found)
    print(text)
    return code


if __name__ == "__main__":
    sys.exit(main())
