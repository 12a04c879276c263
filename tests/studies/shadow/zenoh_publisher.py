"""A router, and a robot with rmw_zenoh's keys behind it: zenoh_publisher.py ANGLES.npy PORT RATE SECONDS."""

import struct
import sys
import time
from typing import Any

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

ROS = get_typestore(Stores.ROS2_JAZZY)
KIND = "sensor_msgs/msg/JointState"
WIRE = f"sensor_msgs::msg::dds_::JointState_/{ROS.hash_rihs01(KIND)}"
TOKEN = f"@ros2_lv/0/5ab1/0/7/MP/%/%/robot/%joint_states/{WIRE}/::,10:,:,:,,"


def session(mode: str, port: str) -> Any:
    """A session that is the router, or one of its clients."""
    configuration = zenoh.Config()
    configuration.insert_json5("mode", f'"{mode}"')
    side = "listen" if mode == "router" else "connect"
    configuration.insert_json5(f"{side}/endpoints", f'["tcp/127.0.0.1:{port}"]')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(configuration)


def main() -> None:
    path, port, rate, seconds = sys.argv[1:]
    angles = np.load(path)
    router, robot = session("router", port), session("client", port)
    token = robot.liveliness().declare_token(TOKEN)
    publisher = robot.declare_publisher(f"0/joint_states/{WIRE}")
    print("ready", flush=True)
    while not publisher.matching_status.matching:
        time.sleep(0.01)
    time.sleep(0.3)
    n = round(float(rate) * float(seconds))
    begun, since = time.monotonic(), time.time_ns()
    names = ["m1", "m2", "m3", "l1", "l2", "l3"]
    kinds, empty = ROS.types, np.zeros(0)
    for k in range(n):
        time.sleep(max(0.0, begun + k / float(rate) - time.monotonic()))
        ns = since + round(k / float(rate) * 1e9)
        stamp = kinds["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        header = kinds["std_msgs/msg/Header"](stamp, "base")
        message = kinds[KIND](header, names, angles[k % len(angles)], empty, empty)
        # sequence number, source time, and who: what rmw_zenoh attaches
        attachment = struct.pack("<qqB", k + 1, ns, 16) + bytes(16)
        publisher.put(bytes(ROS.serialize_cdr(message, KIND)), attachment=attachment)
    time.sleep(1.0)
    del token
    robot.close()
    router.close()


if __name__ == "__main__":
    main()
