"""A robot to try `twin shadow` with: the exported parts stepped by FMPy in wall time, its joints published by DDS.

    twin build fig4_force_position --fmu plant --out robot/plant.fmu
    twin build fig4_force_position --fmu computer --out robot/computer.fmu
    python examples/robot_stand_in/robot.py robot --set contact.stiffness_N_per_m=1500 --clock-offset-s 0.3

Nothing of twin runs in here. What is set here the twin does not know: parameters of plant and computer, noise of the
encoders, a clock that is off and drifts, faults. Messages are those of a robot with ROS 2: /joint_states with six
angles, and /commands with the three motor speeds that its controller wants.
"""

import argparse
import math
import random
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

TICK = 1e-3
JOINTS = ["m1", "m2", "m3", "l1", "l2", "l3"]


@dataclass
@final
class Time_(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header_(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time_
    frame_id: str


@dataclass
@final
class JointState_(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header_
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


class Slave:
    """An FMU for co-simulation, by names.

    Args:
        path: of the file.
        start: parameters and inputs before it begins.
    """

    def __init__(self, path: Path, start: dict[str, float]):
        description = read_model_description(str(path))
        self.references = {one.name: one.valueReference for one in description.modelVariables}
        self.defaults = {one.name: one.start for one in description.modelVariables}
        self.folder = extract(str(path))
        self.fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=self.folder, instanceName=path.stem,
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        for name, value in start.items():
            self.put([name], [value])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def put(self, names: list[str], values: list[float]) -> None:
        self.fmu.setReal([self.references[name] for name in names], values)

    def take(self, names: list[str]) -> list[float]:
        return list(self.fmu.getReal([self.references[name] for name in names]))

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def three(name: str) -> list[str]:
    return [f"{name}[{i + 1}]" for i in range(3)]


class Robot:
    """Computer, drives and plant, each stepped in turn with the newest values of the others.

    Args:
        folder: with plant.fmu and computer.fmu.
        drive: FMU of each joint.
        settings: parameters by their names in the FMUs.
    """

    def __init__(self, folder: Path, drive: Path, settings: dict[str, float]):
        def own(path: Path) -> dict[str, float]:
            known = {one.name for one in read_model_description(str(path)).modelVariables}
            return {name: value for name, value in settings.items() if name in known}

        plant, computer = folder / "plant.fmu", folder / "computer.fmu"
        unknown = set(settings) - set(own(plant)) - set(own(computer))
        if unknown:
            raise SystemExit(f"robot.py: no parameter {', '.join(sorted(unknown))} in {plant} or {computer}")
        self.plant = Slave(plant, own(plant))
        # a drive counts from its own zero
        self.rest = self.plant.take(three("plant.theta_m_rest"))
        theta_l, load = self.plant.take(three("plant.theta_l")), self.plant.take(three("plant.tau_load"))
        shafts = dict(zip(three("theta_m") + three("theta_l"), self.rest + theta_l, strict=True))
        self.computer = Slave(computer, own(computer) | shafts)
        self.drives = [Slave(drive, {"droop": 0.6, "tau_load": load[i]}) for i in range(3)]
        self.theta_m, self.theta_l, self.load = self.rest, theta_l, load
        self.t = 0.0
        turns = ("controller.model.motor_counts_per_turn", "controller.model.joint_counts_per_turn")
        self.per_count = [2.0 * math.pi / float(self.computer.defaults[name]) for name in turns]

    def step(self) -> tuple[list[float], list[float]]:
        """One tick; the six angles that the encoders give, and the commanded motor speeds, at its beginning."""
        self.computer.put(three("theta_m") + three("theta_l"), self.theta_m + self.theta_l)
        self.computer.fmu.doStep(self.t, TICK)
        found = self.computer.take(three("encoder.count_m") + three("encoder.count_l") + three("controller.omega_ref"))
        for i, drive in enumerate(self.drives):
            drive.put(["omega_ref", "tau_load"], [found[6 + i], self.load[i]])
            drive.fmu.doStep(self.t, TICK)
        self.theta_m = [drive.take(["theta_m"])[0] + self.rest[i] for i, drive in enumerate(self.drives)]
        self.plant.put(three("theta_m"), self.theta_m)
        self.plant.fmu.doStep(self.t, TICK)
        self.theta_l, self.load = self.plant.take(three("plant.theta_l")), self.plant.take(three("plant.tau_load"))
        self.t += TICK
        motor, joint = self.per_count
        return [c * motor for c in found[:3]] + [c * joint for c in found[3:6]], found[6:]

    def close(self) -> None:
        for slave in (self.computer, self.plant, *self.drives):
            slave.close()


class Driver:
    """Publishes what the robot says, with what may be wrong about it.

    Args:
        asked: the command line.
    """

    def __init__(self, asked: argparse.Namespace):
        self.asked, self.random = asked, random.Random(asked.seed)
        self.participant = DomainParticipant(asked.domain)
        kind = Policy.Reliability.BestEffort if asked.best_effort else Policy.Reliability.Reliable(duration(seconds=1))
        self.qos = Qos(kind, Policy.Durability.Volatile, Policy.History.KeepLast(1000))
        self.writer, self.commands = self._writer("rt/joint_states"), self._writer("rt/commands")
        self.second = self._writer("rt/joint_states") if asked.publishers == 2 else None
        self.waiting: list[tuple[float, JointState_]] = []

    def matched(self) -> bool:
        return bool(self.writer.get_publication_matched_status().current_count)

    def say(self, k: int, angles: list[float], speeds: list[float]) -> None:
        """Sample number `k`."""
        asked = self.asked
        t = k * asked.period_ms * 1e-3
        if asked.silent and asked.silent[0] <= t < asked.silent[0] + asked.silent[1]:
            return
        ns = self._stamp(t)
        names, values = list(JOINTS), [math.degrees(angle) for angle in angles] if asked.degrees else list(angles)
        if asked.nan_at_s is not None and asked.nan_at_s <= t < asked.nan_at_s + 0.1:
            values[0] = math.nan
        if asked.drift_deg_per_s and t > asked.drift_from_s:
            values[3] += math.radians(asked.drift_deg_per_s) * (t - asked.drift_from_s)
        order = list(range(6))
        if asked.shuffled:
            self.random.shuffle(order)
        if asked.missing:
            order.remove(JOINTS.index(asked.missing))
        if self.random.random() < asked.loss:
            return
        halves = [order] if self.second is None else [order[0::2], order[1::2]]
        for half, writer in zip(halves, (self.writer, self.second), strict=False):
            message = self._message(ns, [names[i] for i in half], [values[i] for i in half], [])
            if asked.jitter_ms:
                self.waiting.append((time.monotonic() + self.random.random() * asked.jitter_ms * 1e-3, message))
            elif writer is not None:
                writer.write(message)
        self.commands.write(self._message(ns, ["m1", "m2", "m3"], [], speeds))
        self.send_due()

    def send_due(self) -> None:
        """What has waited long enough, in whatever order that gives."""
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

    def begin(self) -> None:
        """The first sample is now."""
        self.begun = time.time_ns()

    def _message(self, ns: int, names: list[str], position: list[float], velocity: list[float]) -> JointState_:
        stamp = Time_(ns // 10**9, ns % 10**9)
        return JointState_(Header_(stamp, "base"), names, position, velocity, [])

    def _writer(self, topic: str) -> Any:
        return DataWriter(self.participant, Topic(self.participant, topic, JointState_), qos=self.qos)


def asked_for() -> argparse.Namespace:
    """The command line."""
    line = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = line.add_argument
    add("folder", type=Path, help="with plant.fmu and computer.fmu")
    add("--drive", type=Path, default=Path("fmus/velocity_servo/velocity_servo.fmu"), help="FMU of each joint")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="parameter of plant or computer")
    add("--period-ms", type=int, default=2, help="between two messages")
    add("--seconds", type=float, default=20.0, help="how long it moves")
    add("--domain", type=int, default=0, help="of DDS, as ROS_DOMAIN_ID")
    add("--seed", type=int, default=1)
    add("--at-once", action="store_true", help="do not wait for a subscriber")
    add("--best-effort", action="store_true")
    add("--publishers", type=int, choices=(1, 2), default=1, help="2: each publishes half of the joints")
    add("--clock-offset-s", type=float, default=0.0, help="the robot's clock is ahead by this")
    add("--clock-drift", type=float, default=0.0, help="and goes fast by this share")
    add("--restart-at-s", type=float, help="its clock counts from 0, and does so again from here on")
    add("--silent", type=float, nargs=2, metavar=("AT", "FOR"), help="says nothing for some time, s")
    add("--loss", type=float, default=0.0, help="share of messages that are not sent")
    add("--jitter-ms", type=float, default=0.0, help="messages wait up to this long, each for itself")
    add("--shuffled", action="store_true", help="another order of joints in every message")
    add("--missing", choices=JOINTS, help="a joint that is never named")
    add("--degrees", action="store_true", help="angles in degrees, against REP 103")
    add("--nan-at-s", type=float, help="the first motor's angle is NaN for 0.1 s")
    add("--drift-deg-per-s", type=float, default=0.0, help="the first joint's encoder drifts")
    add("--drift-from-s", type=float, default=0.0)
    return line.parse_args()


def main() -> None:
    asked = asked_for()
    settings = {name: float(value) for name, _, value in (text.partition("=") for text in asked.set)}
    robot, driver = Robot(asked.folder, asked.drive, settings), Driver(asked)
    print("ready", flush=True)
    while not (asked.at_once or driver.matched()):
        time.sleep(0.01)
    time.sleep(0.2)
    driver.begin()
    begun = time.monotonic()
    said = 0
    for tick in range(round(asked.seconds / TICK)):
        angles, speeds = robot.step()
        if tick % asked.period_ms == 0:
            # absolute deadlines: what is late is not skipped
            time.sleep(max(0.0, begun + tick * TICK - time.monotonic()))
            driver.say(said, angles, speeds)
            said += 1
    while driver.waiting:
        driver.send_due()
        time.sleep(1e-3)
    time.sleep(0.5)
    print(f"said {said} in {time.monotonic() - begun:.2f} s", flush=True)
    robot.close()


if __name__ == "__main__":
    main()
