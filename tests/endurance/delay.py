"""`python -m tests.endurance.delay A B SECONDS`: a line between two network namespaces that holds every packet so long.

Two TUN devices, one in each namespace, are its ends; no kernel module such as sch_netem is needed. It prints a word
when it is up.
"""

import ctypes
import fcntl
import os
import select
import struct
import subprocess
import sys
import time
from collections import deque

NEW_NETWORK, SET_INTERFACE, TUN_WITHOUT_HEAD = 0x40000000, 0x400454CA, 0x1001
"""linux/sched.h CLONE_NEWNET; linux/if_tun.h TUNSETIFF, IFF_TUN | IFF_NO_PI."""
NEAR, FAR = "10.77.0.1", "10.77.0.2"
"""Addresses of the ends."""


def end(namespace: str, own: str, other: str) -> int:
    """The file whose reads are packets that leave `namespace`."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/self/ns/net") as home, open(f"/run/netns/{namespace}") as there:
        if libc.setns(there.fileno(), NEW_NETWORK):
            raise OSError(ctypes.get_errno(), "setns")
        file = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(file, SET_INTERFACE, struct.pack("16sH", b"line", TUN_WITHOUT_HEAD))
        libc.setns(home.fileno(), NEW_NETWORK)
    for what in (
        ("addr", "add", own, "peer", other, "dev", "line"),
        ("link", "set", "line", "up"),
        ("link", "set", "lo", "up"),
    ):
        subprocess.run(["ip", "-n", namespace, *what], check=True)
    return file


def main() -> None:
    a, b, seconds = sys.argv[1:]
    ends = end(a, NEAR, FAR), end(b, FAR, NEAR)
    other = dict(zip(ends, reversed(ends), strict=True))
    print("up", flush=True)
    held: deque[tuple[float, int, bytes]] = deque()
    while True:
        wait = max(0.0, held[0][0] - time.monotonic()) if held else None
        for file in select.select(ends, [], [], wait)[0]:
            held.append((time.monotonic() + float(seconds), other[file], os.read(file, 65536)))
        while held and held[0][0] <= time.monotonic():
            _, file, packet = held.popleft()
            os.write(file, packet)


if __name__ == "__main__":
    main()
