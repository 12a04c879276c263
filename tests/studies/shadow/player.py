"""A process that plays a recorded run as a robot whose messages have faults: player.py RUN.npy [--loss 0.05] ...

RUN.npy has a row every 2 ms: six joint angles (rad) and three commanded motor speeds (rad/s). They are published by DDS
on /joint_states and /commands_applied, with lost, late, shuffled, degree, NaN or drifting values, or a restarted clock.
"""

import argparse
import math
import random
import time
from typing import Any

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from twin.kernel.recording.sources.ros_types import idl_class

PERIOD = 2e-3
JOINTS = ("m1", "m2", "m3", "l1", "l2", "l3")
JointState = idl_class("sensor_msgs/msg/JointState")
Header, Time = idl_class("std_msgs/msg/Header"), idl_class("builtin_interfaces/msg/Time")


def joint_state(ns: int, names: Any, position: Any = (), velocity: Any = (), effort: Any = ()) -> Any:
    """A JointState stamped `ns`."""
    stamp = Time(ns // 10**9, ns % 10**9)
    return JointState(Header(stamp, "base"), list(names), list(position), list(velocity), list(effort))


class Player:
    """Publishes rows with the faults of the command line."""

    def __init__(self, asked: argparse.Namespace):
        self.asked, self.random = asked, random.Random(asked.seed)
        self.participant = DomainParticipant(asked.domain)
        reliable = Policy.Reliability.Reliable(duration(seconds=1))
        self.qos = Qos(reliable, Policy.Durability.Volatile, Policy.History.KeepLast(1000))
        self.writer, self.commands = self._writer("rt/joint_states"), self._writer("rt/commands_applied")
        self.second = self._writer("rt/joint_states") if asked.publishers == 2 else None
        self.waiting: list[tuple[float, Any]] = []
        self.begun = time.time_ns()

    def matched(self) -> bool:
        return bool(self.writer.get_publication_matched_status().current_count)

    def publish(self, k: int, angles: list[float], speeds: list[float]) -> None:
        """Publish sample number `k`."""
        asked, t = self.asked, k * PERIOD
        if asked.silent and asked.silent[0] <= t < asked.silent[0] + asked.silent[1]:
            return
        ns, values = self._stamp(t), [math.degrees(angle) for angle in angles] if asked.degrees else list(angles)
        if asked.nan_at_s is not None and asked.nan_at_s <= t < asked.nan_at_s + 0.1:
            values[0] = math.nan
        if asked.drift_deg_per_s:
            values[3] += math.radians(asked.drift_deg_per_s) * t
        order = list(range(6))
        if asked.shuffled:
            self.random.shuffle(order)
        if asked.missing:
            order.remove(JOINTS.index(asked.missing))
        if self.random.random() < asked.loss:
            return
        halves = [order] if self.second is None else [order[0::2], order[1::2]]
        for half, writer in zip(halves, (self.writer, self.second), strict=False):
            message = joint_state(ns, [JOINTS[i] for i in half], [values[i] for i in half])
            if asked.jitter_ms:
                self.waiting.append((time.monotonic() + self.random.random() * asked.jitter_ms * 1e-3, message))
            else:
                writer.write(message)
        self.commands.write(joint_state(ns, JOINTS[:3], velocity=speeds))
        self.send_due()

    def send_due(self) -> None:
        """Publish the messages that have waited long enough, in the order that results."""
        now = time.monotonic()
        for one in [one for one in self.waiting if one[0] <= now]:
            self.waiting.remove(one)
            self.writer.write(one[1])

    def _stamp(self, t: float) -> int:
        asked = self.asked
        if asked.restart_at_s is not None:
            # a clock that counts from its own start, twice
            return round((t if t < asked.restart_at_s else t - asked.restart_at_s) * 1e9)
        return self.begun + round((t * (1.0 + asked.clock_drift) + asked.clock_offset_s) * 1e9)

    def _writer(self, topic: str) -> Any:
        return DataWriter(self.participant, Topic(self.participant, topic, JointState), qos=self.qos)


def main() -> None:
    line = argparse.ArgumentParser()
    add = line.add_argument
    add("run")
    add("--seconds", type=float, default=20.0)
    add("--domain", type=int, default=0)
    add("--seed", type=int, default=1)
    add("--at-once", action="store_true", help="do not wait for a subscriber")
    add("--publishers", type=int, choices=(1, 2), default=1, help="2: each publishes half of the joints")
    add("--clock-offset-s", type=float, default=0.0, help="how far the robot's clock is ahead")
    add("--clock-drift", type=float, default=0.0, help="share by which it is fast")
    add("--restart-at-s", type=float, help="its clock counts from 0, and does so again from here on")
    add("--silent", type=float, nargs=2, metavar=("AT", "FOR"), help="a time without messages, s")
    add("--loss", type=float, default=0.0, help="share of messages that are not sent")
    add("--jitter-ms", type=float, default=0.0, help="messages wait up to this long, each for itself")
    add("--shuffled", action="store_true", help="another order of joints in every message")
    add("--missing", choices=JOINTS, help="a joint that is never named")
    add("--degrees", action="store_true", help="angles in degrees, against REP 103")
    add("--nan-at-s", type=float, help="the first motor's angle is NaN for 0.1 s")
    add("--drift-deg-per-s", type=float, default=0.0, help="drift of the first joint's encoder")
    asked = line.parse_args()
    rows, player = np.load(asked.run).tolist(), Player(asked)
    print("ready", flush=True)
    while not (asked.at_once or player.matched()):
        time.sleep(0.01)
    time.sleep(0.2)
    begun, player.begun = time.monotonic(), time.time_ns()
    for k in range(round(asked.seconds / PERIOD)):
        # absolute deadlines: late messages are not skipped
        time.sleep(max(0.0, begun + k * PERIOD - time.monotonic()))
        row = rows[k % len(rows)]
        player.publish(k, row[:6], row[6:])
    while player.waiting:
        player.send_due()
        time.sleep(1e-3)
    time.sleep(0.5)


if __name__ == "__main__":
    main()
