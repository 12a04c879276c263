"""A part of another make on the inputs of a run: the same calls again and again, with nothing around it."""

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.cosim.component import Component
from twin.cosim.playback import play
from twin.cosim.port import by_port, width
from twin.drive.component import FmuComponent
from twin.errors import ComponentFailed
from twin.experiment.experiment import Experiment
from twin.runs.assembly.robot import ROBOT
from twin.runs.assembly.roles import OtherPart
from twin.runs.trace import Trace

PATIENCE = 5.0
"""Wall time (s) after which a part that is slow has been called often enough."""
BLOCK = 500
"""Calls between two looks at the clock."""
NUDGE = 1e-3
"""By which inputs are changed, of their size or in SI, to see what follows: less than anybody would notice."""


@dataclass(frozen=True)
class Inputs:
    """What a part gets at each of its samples.

    Attributes:
        t: times of the samples (n,), s.
        period: between two of them (s).
        u: (n, inputs), SI.
    """

    t: NDArray[np.float64]
    period: float
    u: NDArray[np.float64]

    def first(self, count: int) -> "Inputs":
        """The first samples."""
        return replace(self, t=self.t[:count], u=self.u[:count])

    def after(self, count: int) -> "Inputs":
        """All but the first samples."""
        return replace(self, t=self.t[count:], u=self.u[count:])

    def nudged(self) -> "Inputs":
        """Each a little different, and none as the one before."""
        signs = np.where(np.arange(self.u.shape[1]) % 2, 1.0, -1.0)
        return replace(self, u=self.u + NUDGE * signs * np.maximum(np.abs(self.u), 1.0))


@dataclass(frozen=True)
class Played:
    """What a part made of inputs.

    Attributes:
        rows: outputs (calls, outputs); fewer calls than asked for if one failed, or they took too long.
        failure: of the call after the last row, as the verb phrase of a sentence; "" if none failed.
        cost: wall time per call (s).
    """

    rows: NDArray[np.float64]
    failure: str
    cost: float


def inputs_for(part: OtherPart, run: Trace, experiment: Experiment, period: int) -> Inputs:
    """What `part` would have got in the `run` of `experiment`.

    Args:
        period: of the part, in ticks.
    """
    (row,) = [row for row in ROBOT if row.name == part.role]
    ticks = np.arange(0, experiment.duration_ticks + 1, period)
    columns = [np.zeros((len(ticks), 0))]
    for port in part.inputs:
        # a controller of twin's own brings its way itself
        sources = [f"{name}.{output}" for name, output in (*row.inputs[port.name], (part.role, port.name))]
        name = next(source for source in sources if source in run.fields())
        columns.append(run.held(name)[ticks].reshape(len(ticks), port.size).astype(float))
    tick = experiment.cosim.tick
    return Inputs(np.asarray(ticks * tick), period * tick, np.hstack(columns))


def played(component: Component, inputs: Inputs) -> Played:
    """Call `component` at the samples of `inputs`, for as long as there is patience."""
    blocks: list[NDArray[np.float64]] = []
    # no call: compiles, or loads from the cache, before the clock runs
    play(component, inputs.t[:0], inputs.t[:0], inputs.u[:0])
    began, failure, done = time.perf_counter(), "", 0
    while done < len(inputs.t) and not failure and time.perf_counter() - began < PATIENCE:
        block = slice(done, done + BLOCK)
        t = inputs.t[block]
        rows, status = play(component, t, np.full(len(t), inputs.period), inputs.u[block])
        finite = np.isfinite(rows).all(axis=1)
        good = len(rows) if finite.all() else int(np.argmin(finite))
        if good < len(t):
            failure = component.explain(status) if good == len(rows) else not_finite(component, rows[good])
        blocks.append(rows[:good])
        done += good
    rows = np.concatenate(blocks) if blocks else np.empty((0, width(component.outputs)))
    return Played(rows, failure, (time.perf_counter() - began) / max(1, done))


def not_finite(component: Component, row: NDArray[np.float64]) -> str:
    """Which output of `row` is no number, as the verb phrase of a sentence."""
    names = [name for name, values in by_port(component.outputs, row).items() if not np.isfinite(values).all()]
    return f"returned NaN or infinity for {', '.join(names)}"


def played_again(component: FmuComponent, inputs: Inputs) -> Played:
    """The same after FMI's reset.

    Raises:
        ComponentFailed: the FMU refuses it.
    """
    component.instance.reset()
    return played(component, inputs)


def replayed_from_state(component: FmuComponent, inputs: Inputs) -> bool:
    """Whether the second half of `inputs` gives the same bits when the FMU is set back to where it began.

    Raises:
        ComponentFailed: the FMU refuses to save or restore its state.
    """
    half = len(inputs.t) // 2
    played(component, inputs.first(half))
    state = component.instance.saved_state()
    once = played(component, inputs.after(half))
    component.instance.restore(state)
    again = played(component, inputs.after(half))
    if once.failure or again.failure:
        raise ComponentFailed(f"{component.label}: {once.failure or again.failure}")
    count = min(len(once.rows), len(again.rows))
    return bool(np.array_equal(once.rows[:count], again.rows[:count]))
