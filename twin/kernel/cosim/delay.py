"""Pure delay by whole ticks, for computation or bus latency; playback of any component over given inputs."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray, copy
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import (
    Component,
    NativeComponent,
    Pieces,
    call_step,
    copy_pieces,
    doubles_at,
    step_function,
)
from twin.kernel.cosim.port import Port, by_port, record, state, width

DELAY_MEMORY = record(size="i8", ticks="i8", position=state("i8", below="ticks"), ring=state("i8"))
NO_PIECES = Pieces([])


@step_function(DELAY_MEMORY)
def step(m, t, h, u, y):
    ring = carray(doubles_at(m.ring), m.size * m.ticks)
    u_, y_ = carray(u, m.size), carray(y, m.size)
    start = m.position * m.size
    for j in range(m.size):
        y_[j] = ring[start + j]
        ring[start + j] = u_[j]
    m.position = (m.position + 1) % m.ticks
    return 0


@step_function(DELAY_MEMORY)
def fill_ring(m, t, h, u, y):
    """Fill the ring buffer of a delay with the present inputs, as if they had always been constant."""
    ring = carray(doubles_at(m.ring), m.size * m.ticks)
    u_, y_ = carray(u, m.size), carray(y, m.size)
    for j in range(m.size):
        y_[j] = u_[j]
        for tick in range(m.ticks):
            ring[tick * m.size + j] = u_[j]
    return 0


def delay(name: str, ports: tuple[Port, ...], ticks: int, initial: np.ndarray) -> Component:
    """Make a sampled component that outputs its inputs of `ticks` (>= 1) ticks ago, and `initial` before that."""
    ring = np.tile(np.asarray(initial, dtype=float), (ticks, 1))
    memory = np.array([(width(ports), ticks, 0, 0)], dtype=DELAY_MEMORY)
    return NativeComponent(name, ports, ports, True, step, memory, ring[0].copy(), pointers={"ring": ring})


@entry(
    "int", "int", "int", "doubles", "doubles", "int", "int", "integers", "int", "int", "int", "int", "integers",
    "int", "int", "int", "int",
)  # fmt: skip
def _play(
    step, self, t, h, u_address, u_bytes, steps, count, y_address, rows_address, row_bytes, failed,
    table, pieces, copies_address, copy_bytes,
):  # fmt: skip
    """Step a component `steps[k]` times for each row k of inputs; store outputs and `pieces` of memory after each row.

    Return the completed rows: `count`, or fewer if a step `failed`.
    """
    j = 0
    for k in range(count):
        for _ in range(steps[k]):
            status = call_step(step, (self, t[j], h[j], u_address + j * u_bytes, y_address))
            if status != 0 and status != 1:
                failed[0] = status
                return k
            j += 1
        copy(rows_address + k * row_bytes, y_address, row_bytes)
        copy_pieces(table, pieces, copies_address + k * copy_bytes, 0)
    return count


def play(
    component: Component,
    t: NDArray[np.float64],
    h: NDArray[np.float64],
    u: NDArray[np.float64],
    steps: NDArray[np.int64] | None = None,
    before: NDArray[np.float64] | None = None,
    pieces: Pieces = NO_PIECES,
    copies: NDArray[np.uint8] | None = None,
) -> tuple[NDArray[np.float64], int]:
    """Run a component alone on rows of inputs `u`, from its present state, and return its outputs; changes its memory.

    Args:
        t, h, u: time and length (s) of each step, (m,), and its inputs, (m, inputs).
        steps: number of steps before each row of outputs, shape (n,), m in total; None for one each.
        before: present outputs, shape (outputs,); None for the initial ones.
        pieces, copies: after each row, the `pieces` of memory are copied to a row of `copies` (rows, pieces.size).

    Returns:
        (outputs (rows, outputs), status); fewer rows and the status of the step if one failed, else status 0. Outputs
        that a step does not write keep their value, as in a run.
    """
    steps = np.ones(len(u), dtype=np.int64) if steps is None else steps
    u = np.ascontiguousarray(u, dtype=np.float64)
    y = np.array(component.initial_outputs if before is None else before, dtype=np.float64)
    rows, status = np.empty((len(steps), width(component.outputs))), np.zeros(1, dtype=np.int64)
    done = _play(
        component.step_address, component.self_address, np.ascontiguousarray(t, dtype=float),
        np.ascontiguousarray(h, dtype=float), u, u.strides[0], np.ascontiguousarray(steps, dtype=np.int64),
        len(rows), y, rows, rows.strides[0], status, *pieces.at, 0 if copies is None else copies, pieces.size,
    )  # fmt: skip
    return rows[:done], int(status[0])


def values_by_port(ports: tuple[Port, ...], rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Split rows (n, total width of `ports`) by port: (n,), or (n, size) for a port with several values."""
    parts = by_port(ports, rows)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in parts.items()}
