"""What a part of another make does on the bench, check by check."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.cosim.component import Component
from twin.cosim.port import by_port
from twin.drive.component import FmuComponent
from twin.errors import ComponentFailed
from twin.experiment.experiment import Experiment
from twin.runs.assembly.roles import OtherPart
from twin.runs.trace import Trace
from twin.studies.component.bench import (
    Inputs,
    Played,
    inputs_for,
    played,
    played_again,
    replayed_from_state,
)
from twin.studies.metrics.needs import FIG4, FIG5, MEASURES, OF_A_CONSTANT_FORCE

Verdict = Literal["ok", "fails", "note"]
ENOUGH = 1000
"""Calls of a check that repeats what another one has done."""
LATE = 20
"""Samples within which an output has to answer its inputs."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: of it.
        verdict: "note" does not disqualify.
        detail: one sentence.
    """

    name: str
    verdict: Verdict
    detail: str


@dataclass(frozen=True)
class Checked:
    """A part that has been on the bench.

    Attributes:
        part: what it is.
        period: between two calls (s).
        checks: in the order in which they were made.
        cost: wall time per call (s).
        apart: largest difference to twin's own component on the same inputs, by output, SI; None: not compared.
    """

    part: OtherPart
    period: float
    checks: tuple[Check, ...]
    cost: float
    apart: dict[str, float] | None

    @property
    def good(self) -> bool:
        return all(check.verdict != "fails" for check in self.checks)


def checked_part(
    part: OtherPart, experiment: Experiment, period: int, run: Trace, own: bool, say: Callable[[str], None]
) -> Checked:
    """Call `part` at what it would have got in `run`.

    Args:
        experiment: of the run.
        period: of the part, in ticks.
        own: whether twin's own component had the part in that run.
        say: told what is being done.

    Raises:
        InputRefused: the part cannot be made.
    """
    bench = _Bench(part, experiment, period, inputs_for(part, run, experiment, period))
    say("calling it")
    first = bench.play(bench.inputs)
    checks = [_calls(bench, first), *_scored(part, bool(experiment.tasks))]
    if not first.failure:
        say("calling it again")
        checks += [_repeats(bench, first), *_of_fmu(bench, first), _answers(bench, first)]
    apart = _apart(part, run, bench.inputs, experiment, first.rows) if own else None
    return Checked(part, bench.inputs.period, tuple(checks), first.cost, apart)


@dataclass(frozen=True)
class _Bench:
    """Makes a part anew for each check: one that can live only once in a process has been freed then."""

    part: OtherPart
    experiment: Experiment
    period: int
    inputs: Inputs

    def made(self) -> "closing[Component]":
        return closing(self.part.make(self.experiment.cosim.tick, self.period, self.experiment.duration_ticks))

    def play(self, inputs: Inputs) -> Played:
        with self.made() as component:
            return played(component, inputs)


def _calls(bench: _Bench, first: Played) -> Check:
    n, count = len(first.rows), len(bench.inputs.t)
    if first.failure:
        t = bench.inputs.t[n]
        return Check("calls", "fails", f"{first.failure} at t = {t:.6g} s, call {n + 1}")
    if n < count:
        return Check("calls", "ok", f"{n} of {count} calls, all outputs finite; the rest would take too long")
    return Check("calls", "ok", f"{n} calls, all outputs finite")


def _scored(part: OtherPart, has_tasks: bool) -> Iterator[Check]:
    """What a run with this part cannot be scored by, because the part lacks a port that twin's own has."""
    ports = {f"{part.role}.{port.name}" for port in part.outputs}
    measures = {name: needs for name, needs in MEASURES.items() if not (has_tasks and name in OF_A_CONSTANT_FORCE)}
    figure, series = ("fig5", FIG5) if has_tasks else ("fig4", FIG4)
    missing = [name for name in series if name.startswith(f"{part.role}.") and name not in ports]
    lost = [name for name, needs in measures.items() if set(missing) & set(needs)]
    if missing:
        measured = f"twin report cannot score {', '.join(lost)}; " if lost else ""
        names = ", ".join(name.removeprefix(f"{part.role}.") for name in missing)
        detail = f"no output {names}: {measured}twin compare --paper {figure} not what rests on them"
        yield Check("scored", "note", detail)


def _repeats(bench: _Bench, first: Played) -> Check:
    inputs = bench.inputs.first(min(ENOUGH, len(first.rows)))
    again = bench.play(inputs)
    same = _same(first, again)
    return Check("repeatable", "ok" if same else "fails", _sameness("a new one", same, again))


def _of_fmu(bench: _Bench, first: Played) -> Iterator[Check]:
    if bench.part.fmu is None:
        return
    inputs = bench.inputs.first(min(ENOUGH, len(first.rows)))
    with bench.made() as component:
        assert isinstance(component, FmuComponent)
        played(component, inputs)
        try:
            again = played_again(component, inputs)
            same = _same(first, again)
            yield Check("reset", "ok" if same else "note", _sameness("after a reset it", same, again))
        except ComponentFailed as problem:
            yield Check("reset", "note", f"{problem}; runs and sweeps make it anew each time")
    if not bench.part.fmu.interface.canGetAndSetFMUstate:
        yield Check("state", "note", "cannot be saved and restored, which a run does not need")
        return
    with bench.made() as component:
        assert isinstance(component, FmuComponent)
        try:
            same = replayed_from_state(component, inputs)
            said = "set back, it does " + ("the same" if same else "something else")
            yield Check("state", "ok" if same else "note", said)
        except ComponentFailed as problem:
            yield Check("state", "note", str(problem))


def _answers(bench: _Bench, first: Played) -> Check:
    """When outputs answer inputs: at the sample itself, as twin takes it, or later."""
    if not bench.part.inputs:
        return Check("instant", "ok", "takes no inputs")
    k = min(len(first.rows) // 2, ENOUGH)
    rest = bench.inputs.after(k).first(LATE)
    with bench.made() as component:
        played(component, bench.inputs.first(k))
        nudged = played(component, rest.nudged())
    rows = first.rows[k : k + len(nudged.rows)]
    moved = np.flatnonzero(np.any(nudged.rows[: len(rows)] != rows, axis=1))
    if not len(moved):
        return Check("instant", "note", f"no output answers its inputs within {LATE} samples")
    if moved[0] == 0:
        return Check("instant", "ok", "outputs of t_k answer the inputs of t_k")
    late = 1e3 * bench.inputs.period * int(moved[0])
    return Check("instant", "note", f"outputs answer inputs {late:g} ms late: a delay inside, besides delay_ticks")


def _same(first: Played, again: Played) -> bool:
    n = min(len(first.rows), len(again.rows))
    return not again.failure and bool(np.array_equal(first.rows[:n], again.rows[:n]))


def _sameness(who: str, same: bool, again: Played) -> str:
    if again.failure:
        return f"{who} {again.failure}"
    return f"{who} gives " + ("the same bits" if same else "other outputs from the same inputs")


def _apart(
    part: OtherPart, run: Trace, inputs: Inputs, experiment: Experiment, rows: NDArray[np.float64]
) -> dict[str, float]:
    ticks = np.rint(inputs.t[: len(rows)] / experiment.cosim.tick).astype(int)
    return {
        name: float(np.max(np.abs(values - run.held(f"{part.role}.{name}")[ticks].reshape(values.shape)), initial=0.0))
        for name, values in by_port(part.outputs, rows).items()
        if f"{part.role}.{name}" in run.fields()
    }
