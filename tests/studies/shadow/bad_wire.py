"""A wire between two network namespaces that loses and delays: bad_wire.py FROM TO LOSS DELAY HELD [BURST].

Each end is a TAP device in its namespace, `wire0` and `wire1`. Of the frames from the first to the second a share is
lost, and in each second all within BURST (s); the others take between no time and DELAY (s). A delay holds for HELD
(s): at 0 each frame has its own, and they overtake each other; else they stay in order, as in a queue. Back they all
go at once.
"""

import contextlib
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import sys
import time

TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
FRAME = 65_536


def end(name: str, namespace: str) -> int:
    """A TAP device in a namespace, up; the file with its frames."""
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(file, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    subprocess.run(["ip", "link", "set", name, "netns", namespace], check=True)
    return file


def pass_on(file: int, frame: bytes) -> None:
    # an end that is not up yet takes nothing
    with contextlib.suppress(OSError):
        os.write(file, frame)


def main(robot: str, twin: str, loss: float, delay: float, held: float, burst: float = 0.0) -> None:
    ends, drawn = [end("wire0", robot), end("wire1", twin)], random.Random(1)
    print("ready", flush=True)
    waiting: list[tuple[float, int, bytes]] = []
    count, until, now_takes, last = 0, 0.0, 0.0, 0.0
    while True:
        wait = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for file in select.select(ends, [], [], wait)[0]:
            frame = os.read(file, FRAME)
            if file == ends[1]:
                pass_on(ends[0], frame)
            elif drawn.random() >= loss and time.monotonic() % 1.0 >= burst:
                count, now = count + 1, time.monotonic()
                if now >= until:
                    until, now_takes = now + held, drawn.random() * delay
                last = max(last, now + now_takes) if held else now + now_takes
                heapq.heappush(waiting, (last, count, frame))
        while waiting and waiting[0][0] <= time.monotonic():
            pass_on(ends[1], heapq.heappop(waiting)[2])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(float, sys.argv[3:7]))
