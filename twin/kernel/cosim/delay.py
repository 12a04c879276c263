"""A pure delay of whole ticks, for a computation or a bus that takes time."""

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
    """What a delay that is taken elsewhere does before its first step: its inputs have been as they are."""
    ring = carray(doubles_at(m.ring), m.size * m.ticks)
    u_, y_ = carray(u, m.size), carray(y, m.size)
    for j in range(m.size):
        y_[j] = u_[j]
        for tick in range(m.ticks):
            ring[tick * m.size + j] = u_[j]
    return 0


def delay(name: str, ports: tuple[Port, ...], ticks: int, initial: np.ndarray) -> Component:
    """Sampled component: its outputs `ports` are its inputs of `ticks` (>= 1) ticks ago, before that `initial`."""
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
    """Row k becomes the outputs after `steps[k]` more steps, row k of the copies the `pieces` of memory of the `table`
    then; rows done, all of `count` unless a step `failed`."""
    j = 0
    for k in range(count):
        for _ in range(steps[k]):
            status = call_step(step, self, t[j], h[j], u_address + j * u_bytes, y_address)
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
    """Step `component` from where it stands, once per row of `u`.

    Args:
        component: its memory is changed.
        t, h: time and length of each step (m,), s.
        u: its inputs at each step (m, inputs).
        steps: after how many steps each row of outputs is taken (n,), m in all; None: after each.
        before: outputs (outputs,) that it has so far; None: its initial ones.
        pieces, copies: of memory, what is there after each row goes to `copies` (rows, pieces.size).

    Returns:
        Outputs (rows, outputs), fewer than asked for if a step failed, and the status of that step, else 0. What a
        step leaves unwritten keeps its value, as in a run.
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


def columns(component: Component, rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """`rows` (n, outputs) by port: (n,), or (n, size) of a port of several."""
    return values_by_port(component.outputs, rows)


def values_by_port(ports: tuple[Port, ...], rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """The same of outputs `ports`."""
    parts = by_port(ports, rows)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in parts.items()}
