"""A process that publishes the joints of a run by DDS: publisher.py RUN.npy RATE SECONDS [--best-effort] [--topic T]

Cyclone DDS, without the sources of twin.
"""

import argparse
import time
from typing import Any

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.studies.shadow.player import JOINTS, JointState, joint_state


def main() -> None:
    line = argparse.ArgumentParser()
    line.add_argument("angles")
    line.add_argument("rate", type=float)
    line.add_argument("seconds", type=float)
    line.add_argument("--domain", type=int, default=0)
    line.add_argument("--best-effort", action="store_true")
    line.add_argument("--topic", default="/joint_states")
    line.add_argument("--pause", type=float, default=0.0, help="nothing for so long, after half of the time")
    asked = line.parse_args()
    angles = np.load(asked.angles)
    kind: Any = Policy.Reliability.BestEffort if asked.best_effort else Policy.Reliability.Reliable(duration(seconds=1))
    participant = DomainParticipant(asked.domain)
    topic = Topic(participant, f"rt{asked.topic}", JointState)
    # the depth that ROS has by default
    writer: Any = DataWriter(participant, topic, qos=Qos(kind, Policy.Durability.Volatile, Policy.History.KeepLast(10)))
    while not writer.get_publication_matched_status().current_count:
        time.sleep(0.01)
    time.sleep(0.3)
    n = round(asked.rate * asked.seconds)
    begun, since = time.monotonic(), time.time_ns()
    for k in range(n):
        if asked.pause and k == n // 2:
            begun += asked.pause
        time.sleep(max(0.0, begun + k / asked.rate - time.monotonic()))
        # of the robot's loop, whose period is exact
        ns = since + round((k / asked.rate + (asked.pause if k >= n // 2 else 0.0)) * 1e9)
        writer.write(joint_state(ns, JOINTS, angles[k % len(angles)].tolist()))
    time.sleep(1.0)
    print(n)


if __name__ == "__main__":
    main()
