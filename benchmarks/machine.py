"""How fast this machine is, by work that never changes: with it figures of two machines can be compared.

One number for each thing that a run waits for: arithmetic that depends on itself (the plant's step), turns of the
interpreter (everything around the loop), and memory (recording).
"""

import time
from collections.abc import Callable

import numpy as np
from numba import njit

from benchmarks.measurement import Measurement, Rounds

ROUNDS = 9
STEPS = 4_000_000
TURNS = 1_000_000
BYTES = 64_000_000


@njit
def chain(steps: int, x: float) -> float:
    """A chain of multiplications and additions, each of which waits for the one before; it tends to 2."""
    for _ in range(steps):
        x = x * 0.5 + 1.0
    return x


def turn(turns: int) -> int:
    """Turns of the interpreter."""
    count = 0
    for number in range(turns):
        count ^= number
    return count


def seconds(work: Callable[[], object]) -> Callable[[], float]:
    """How long `work` takes (s)."""

    def timed() -> float:
        began = time.perf_counter()
        work()
        return time.perf_counter() - began

    return timed


def measurements() -> list[Measurement]:
    """The first lines of the table."""
    chain(1, 0.0)
    source, target = np.ones(BYTES, dtype=np.uint8), np.zeros(BYTES, dtype=np.uint8)
    rounds = Rounds(
        {
            "chain": seconds(lambda: chain(STEPS, 0.0)),
            "turns": seconds(lambda: turn(TURNS)),
            "copy": seconds(lambda: np.copyto(target, source)),
        },
        ROUNDS,
    )
    return [
        Measurement("this machine: a multiplication and an addition", 1e9 * rounds.typical("chain") / STEPS, "ns"),
        Measurement("this machine: a turn of the interpreter", 1e9 * rounds.typical("turns") / TURNS, "ns"),
        Measurement("this machine: a megabyte copied", 1e6 * rounds.typical("copy") / (BYTES / 1e6), "us"),
    ]
