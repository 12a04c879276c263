"""Check of a third-party part: whether it can replace twin's own, called with the inputs of a run."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import by_port
from twin.kernel.cosim.selection import Selection
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import ROLE_CONTRACTS, ThirdPartyPart, third_party_part
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.metrics.required_series import FIG4_SERIES, FIG5_SERIES, MEASURE_SERIES
from twin.studies.qualify.bench import Inputs, PartCalls, call_part, inputs_for, repeats_from_state
from twin.studies.qualify.definitions import Check, make_check
from twin.studies.result import Block, Column, Note, Result, Table

VERDICT_NAMES = {"ok": "ok", "FAIL": "fails", "note": "note"}
MAX_REPEATED_CALLS = 1000
"""Maximum number of calls in a check that repeats another."""
MAX_DELAY_SAMPLES = 20
"""Maximum number of samples until an output must respond to its inputs."""


@dataclass(frozen=True)
class PartAssessment:
    """Result of checking a third-party part: checks, period of its calls and wall time per call (s).

    Attributes:
        own_differences: output name -> largest difference to twin's own component on the same inputs, SI; None if not
            compared.
    """

    part: ThirdPartyPart
    period: float
    checks: tuple[Check, ...]
    cost: float
    own_differences: dict[str, float] | None

    @property
    def fits(self) -> bool:
        return all(check.verdict != "FAIL" for check in self.checks)


def assess_part(
    part: ThirdPartyPart, experiment: Experiment, period: int, run: Trace, own: bool, say: Callable[[str], None]
) -> PartAssessment:
    """Check a part called every `period` ticks with a run's inputs; `own`: twin's own part made the run."""
    bench = _Bench(part, experiment, period, inputs_for(part, run, experiment, period))
    say("calling it")
    first = bench.play(bench.inputs)
    n, count = len(first.rows), len(bench.inputs.t)
    called = f"{n} calls, all outputs finite"
    if first.failure:
        called = f"{first.failure} at t = {bench.inputs.t[n]:.6g} s, call {n + 1}"
    elif n < count:
        called = f"{n} of {count} calls, all outputs finite; the rest would take too long"
    checks = [make_check("calls", not first.failure, called), *_scoring_checks(part, bool(experiment.tasks))]
    if not first.failure:
        say("calling it again")
        inputs = bench.inputs.first(min(MAX_REPEATED_CALLS, len(first.rows)))
        again = bench.play(inputs)
        checks.append(make_check("repeatable", *_compare_repetition("a new one", first, again)))
        checks += [*_fmu_checks(bench, inputs, first), _latency_check(bench, first)]
    apart = _own_differences(part, run, bench.inputs, experiment, first.rows) if own else None
    return PartAssessment(part, bench.inputs.period, tuple(checks), first.cost, apart)


@dataclass(frozen=True)
class _Bench:
    """Provider of a new part instance per check, created after the last one is freed: some parts allow only one."""

    part: ThirdPartyPart
    experiment: Experiment
    period: int
    inputs: Inputs

    def make_component(self) -> "closing[Component]":
        return closing(self.part.make(self.experiment.cosim.tick, self.period, self.experiment.duration_ticks))

    def play(self, inputs: Inputs) -> PartCalls:
        with self.make_component() as component:
            return call_part(component, inputs)


def _scoring_checks(part: ThirdPartyPart, has_tasks: bool) -> Iterator[Check]:
    """Yield a note on measures and claims that cannot be scored because a part lacks an output."""
    ports = {f"{part.role}.{port.name}" for port in part.outputs}
    figure, series = ("fig5", FIG5_SERIES) if has_tasks else ("fig4", FIG4_SERIES)
    missing = [name for name in series if name.startswith(f"{part.role}.") and name not in ports]
    lost = [name for name, needs in MEASURE_SERIES.items() if set(missing) & set(needs)]
    if missing:
        measured = f"twin report cannot score {', '.join(lost)}; " if lost else ""
        names = ", ".join(name.removeprefix(f"{part.role}.") for name in missing)
        detail = f"no output {names}: {measured}twin compare --paper {figure} cannot score claims that need them"
        yield Check("scored", "note", detail)


def _fmu_checks(bench: _Bench, inputs: Inputs, first: PartCalls) -> Iterator[Check]:
    """Yield checks of a part's reset and of saving and restoring its state, which no run needs."""
    if bench.part.fmu is None:
        return
    if not isinstance(bench.part.fmu, FmuDescription):
        yield Check(
            "reset", "note", "not tried: an SSP has no reset, and runs and sweeps make a new instance each time"
        )
        yield from _state_checks(bench, inputs)
        return
    with bench.make_component() as component:
        inside = component.inner if isinstance(component, Selection) else component
        assert isinstance(inside, FmuComponent)
        call_part(component, inputs)
        try:
            inside.instance.reset()
            again = call_part(component, inputs)
            yield make_check("reset", *_compare_repetition("after a reset it", first, again), otherwise="note")
        except ComponentFailed as problem:
            yield Check("reset", "note", f"{problem}; runs and sweeps make a new instance each time")
    yield from _state_checks(bench, inputs)


def _state_checks(bench: _Bench, inputs: Inputs) -> Iterator[Check]:
    """Yield whether a part repeats its outputs from a saved state; "note" if not, as no run needs that."""
    with bench.make_component() as component:
        if lacking := component.lacks_state(portable=False):
            yield Check("state", "note", f"{lacking}; a run does not need it")
            return
        try:
            same = repeats_from_state(component, inputs)
            sentence = "set back, it does " + ("the same" if same else "something else")
            yield make_check("state", same, sentence, otherwise="note")
        except TwinError as problem:
            yield Check("state", "note", str(problem))


def _latency_check(bench: _Bench, first: PartCalls) -> Check:
    """Check whether a part's outputs respond to inputs at the same sample, as twin assumes, or later."""
    if not bench.part.inputs:
        return Check("instant", "ok", "takes no inputs")
    k = min(len(first.rows) // 2, MAX_REPEATED_CALLS)
    rest = bench.inputs.skip(k).first(MAX_DELAY_SAMPLES)
    with bench.make_component() as component:
        call_part(component, bench.inputs.first(k))
        nudged = call_part(component, rest.nudge())
    rows = first.rows[k : k + len(nudged.rows)]
    moved = np.flatnonzero(np.any(nudged.rows[: len(rows)] != rows, axis=1))
    if not len(moved):
        return Check("instant", "note", f"no output answers its inputs within {MAX_DELAY_SAMPLES} samples")
    if moved[0] == 0:
        return Check("instant", "ok", "outputs of t_k answer the inputs of t_k")
    late = 1e3 * bench.inputs.period * int(moved[0])
    return Check(
        "instant", "note", f"outputs answer inputs {late:g} ms late: an internal delay, in addition to delay_ticks"
    )


def _compare_repetition(who: str, first: PartCalls, again: PartCalls) -> tuple[bool, str]:
    """Compare two series of a part's calls; return whether they are equal, and a phrase on the result."""
    n = min(len(first.rows), len(again.rows))
    same = not again.failure and bool(np.array_equal(first.rows[:n], again.rows[:n]))
    outcome = again.failure or "gives " + ("the same bits" if same else "other outputs from the same inputs")
    return same, f"{who} {outcome}"


def _own_differences(
    part: ThirdPartyPart, run: Trace, inputs: Inputs, experiment: Experiment, rows: NDArray[np.float64]
) -> dict[str, float]:
    ticks = np.rint(inputs.t[: len(rows)] / experiment.cosim.tick).astype(int)
    return {
        name: float(np.max(np.abs(values - run.held(f"{part.role}.{name}")[ticks].reshape(values.shape)), initial=0.0))
        for name, values in by_port(part.outputs, rows).items()
        if f"{part.role}.{name}" in run.fields()
    }


def part_check(
    role: str, part: str | None, experiment: Path, settings: Sequence[str], say: Callable[[str], None]
) -> Result:
    """Check whether a third-party part can replace twin's own, by calling it with the inputs of a run.

    The run is one with twin's own part; if `part`, an FMU, mapping, folder with one, or FILE:CLASS, is None, a run
    with the part named in the experiment. Exit code 1: the part does not fit.
    """
    if role not in ROLE_CONTRACTS:
        raise InputRefused(f"{role}: not a part that can be third-party; these can: {', '.join(ROLE_CONTRACTS)}")
    named = [] if part is None else [f"{role}.{'python' if '.py:' in part else 'fmu'}={_absolute(part)!r}"]
    other = load_experiment(experiment, [*named, *settings])
    if role not in other.stand_ins:
        raise InputRefused(f"{other.name}: its {role} is twin's own; name an FMU, or FILE:CLASS")
    found = third_party_part(role, other.stand_ins[role])
    say(f"running {other.name}")
    # Settings of the third-party part do not apply to twin's own.
    rest = [text for text in settings if not text.startswith(f"{role}.")]
    run = run_in_memory(load_experiment(experiment, rest))
    ticks = {"monitor": other.monitor_ticks, "scale": other.scale_ticks, "body": 1}.get(role, other.controller_ticks)
    done = assess_part(found, other, ticks, run, part is not None, say)
    return part_result(done)


def contracts() -> Result:
    facts = {
        role: {
            side: [
                {
                    "name": port.name, "size": port.size, "unit": port.unit, "meaning": port.meaning,
                    "required": side == "outputs" and port.name in contract.required,
                }
                for port in ports
            ]
            for side, ports in (("inputs", contract.inputs), ("outputs", contract.outputs))
        }
        for role, contract in ROLE_CONTRACTS.items()
    }  # fmt: skip
    first, *body = [block for role in ROLE_CONTRACTS for block in (f"[{role}]", _contract(role))]
    return Result(first, body, facts)


def _absolute(part: str) -> str:
    """Return a part's path, if it exists, as absolute, because an experiment resolves it from its own folder."""
    file, colon, name = part.rpartition(":") if ".py:" in part else (part, "", "")
    return f"{Path(file).absolute()}{colon}{name}" if os.path.exists(file) else part


def part_result(done: PartAssessment) -> Result:
    part, label = done.part, done.part.label
    units = {port.name: port.unit for port in part.outputs}
    rows = [
        *((VERDICT_NAMES[check.verdict], check.name, check.detail) for check in done.checks),
        ("", "cost", f"{1e6 * done.cost:.2g} us per call"),
        *(("", name, _difference(apart, units[name])) for name, apart in (done.own_differences or {}).items()),
    ]
    body: list[Block] = [
        *(Note(text, "  ", 4) for text in part.metadata.get("mapped", ())),
        Table((Column("", 6, left=True), Column("", 11, left=True), Column(folds=True)), rows),
        f"{label} {'can take its place' if done.fits else 'cannot take its place'} as {part.role}",
    ]
    headline = f"{part.role}: {label}, every {1e3 * done.period:g} ms, sha256 {part.sha256[:12]}"
    return Result(headline, body, component_facts(done), exit_code=0 if done.fits else 1)


def _difference(apart: float, unit: str) -> str:
    if apart == 0.0:
        return "as twin's own, bit for bit"
    return f"at most {apart:.3g}{'' if unit == '1' else f' {unit}'} from twin's own on the same inputs"


def component_facts(done: PartAssessment) -> dict[str, object]:
    part = done.part
    return {
        "role": part.role,
        "part": dict(part.metadata),
        "period_s": done.period,
        "inputs": [port.name for port in part.inputs],
        "outputs": [port.name for port in part.outputs],
        "checks": [{"name": c.name, "verdict": VERDICT_NAMES[c.verdict], "detail": c.detail} for c in done.checks],
        "cost_s": done.cost,
        "largest_difference_to_own": done.own_differences,
        "good": done.fits,
    }


def _contract(role: str) -> Table:
    contract = ROLE_CONTRACTS[role]
    rows = [
        (
            arrow,
            port.name + f"[{port.size}]" * (port.size > 1),
            port.unit,
            port.meaning + " (needed)" * (port.name in needed),
        )
        for arrow, ports, needed in (("<-", contract.inputs, ()), ("->", contract.outputs, contract.required))
        for port in ports
    ]
    return Table((Column(left=True), Column("", 12, left=True), Column("", 6, left=True), Column(folds=True)), rows)
