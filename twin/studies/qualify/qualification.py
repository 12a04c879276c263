"""The qualification run: every check and measure of one drive."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.fmi.component import distrust, instances_left, opened
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.variable import Setting, Setup, Variable
from twin.kernel.process.guard import JobEnded, JobEndedLoading, guarded
from twin.kernel.process.reporter import Reporter
from twin.robot.assembly.drives import DrivePlan, belongs, planned
from twin.robot.drive.contract import LOAD
from twin.robot.experiment.schema import Drive
from twin.studies.metrics.response import Curve
from twin.studies.qualify import motion
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import (
    AVERAGE,
    CHECKS,
    DROOP_MOST,
    LOAD_IN_USE,
    LOADED,
    MEASURES,
    OFF,
    SPEED_IN_USE,
    STALLS,
    TICK,
    Check,
    Finding,
    Measure,
    judged,
    work_cycle,
)
from twin.studies.qualify.motion import overload

AT_ONCE = 1e4
"""Rate of a load applied almost at once (N m/s)."""
JOB = "twin.studies.qualify.qualification:examined"
TICKS, LONGER = 50, 500
"""Long enough for every sampled loop inside to have come round; and how long a state is looked at."""
SETUP = Setup(stop=(TICKS + LONGER) * TICK, step=TICK)
SHARE_OF_LIMIT = 0.1
"""Of the velocity loop's limit, as the command of a drive that takes no speed."""
OTHER_FUTURE = "it goes on differently from a restored state; twin treats it as without a state"
WRITTEN = "written"
ELSEWHERE = "twin.studies.qualify.qualification:gone_on"
T = TypeVar("T")


def lifecycle_findings(plan: DrivePlan, apart: bool) -> list[Finding]:
    """Checks `reset`, `state` and `written` of every FMU by itself, its inputs held.

    An FMU whose state does not bring the same future back counts as one without a state from now on.

    Args:
        plan: the drive.
        apart: each in a process of its own: an FMU that crashes there costs that check, and nothing else.

    Raises:
        InputRefused: an FMU cannot be loaded or initialised.
    """
    names = (*TRIED, WRITTEN)
    return [_apart(plan, name) if apart else _bookkeeping_check(name, plan) for name in names]


def examined(reporter: Reporter, table: Drive, name: str) -> dict[str, str]:
    """Fields of a check of the drive of `table`; a job of the guard."""
    return asdict(_bookkeeping_check(name, planned(table)))


def _apart(plan: DrivePlan, name: str) -> Check:
    try:
        return Check(**guarded(JOB, {"table": plan.table, "name": name}))
    except (JobEnded, JobEndedLoading) as failure:
        return judged(name, False, str(failure), otherwise="note")


def _bookkeeping_check(name: str, plan: DrivePlan) -> Check:
    problems, found = [], dict[str, str]()
    for part, description in plan.parts.items():
        inputs, outputs = _excitation(plan, part), _watched(plan, part, description)
        instance = opened(part or "drive", description, plan.folder(part), plan.settings[part], inputs, SETUP)
        try:
            if name == WRITTEN:
                problem = _written(plan, part, instance, inputs, outputs)
            else:
                problem = TRIED[name](instance, inputs, outputs)
            if name != "reset" and problem in ("", OTHER_FUTURE):
                found[description.sha256] = found.get(description.sha256, "") or problem
        except TwinError as refusal:
            problem = str(refusal)
        finally:
            instance.close()
        if problem:
            problems.append(f"{part}: {problem}" if part else problem)
    for sha256, problem in found.items():
        if problem or name == "state":
            distrust(sha256, problem)
    return judged(name, not problems, "; ".join(problems) or "bit for bit", otherwise="note")


def _reset(instance: Instance, inputs: list[Setting], outputs: list[Variable]) -> str:
    """What is wrong with its reset; empty if nothing is."""
    first = _exercised(instance, inputs, outputs)
    instance.reset()
    return "" if np.array_equal(first, _exercised(instance, inputs, outputs)) else "a run after reset is another one"


def _state(instance: Instance, inputs: list[Setting], outputs: list[Variable]) -> str:
    """What is wrong with saving and restoring its state; empty if nothing is."""
    if not instance.description.interface.canGetAndSetFMUstate:
        return "not offered"
    _exercised(instance, inputs, outputs)
    state, schedule = instance.taken_state(), [array.copy() for array in instance.schedule]
    onward = _exercised(instance, inputs, outputs, TICKS, LONGER)
    instance.set_state(state)
    instance.forget(state.value)
    for array, saved in zip(instance.schedule, schedule, strict=True):
        array[...] = saved
    again = _exercised(instance, inputs, outputs, TICKS, LONGER)
    return "" if np.array_equal(onward, again) else OTHER_FUTURE


TRIED: dict[str, Callable[[Instance, list[Setting], list[Variable]], str]] = {"reset": _reset, "state": _state}


def _written(plan: DrivePlan, part: str, instance: Instance, inputs: list[Setting], outputs: list[Variable]) -> str:
    """What is wrong with its state in another process; empty if nothing is."""
    if not instance.description.interface.canSerializeFMUstate:
        return "not offered"
    if instance.description.kind == "model_exchange":
        return "not tried: its solver holds a part of the state"
    _exercised(instance, inputs, outputs)
    state = instance.taken_state()
    content = instance.serialized(state)
    instance.forget(state.value)
    schedule = [array.tobytes() for array in instance.schedule]
    onward = _exercised(instance, inputs, outputs, TICKS, LONGER)
    again = guarded(ELSEWHERE, {"table": plan.table, "part": part, "content": content, "schedule": schedule})
    return "" if np.array_equal(onward, again) else OTHER_FUTURE


def gone_on(reporter: Reporter, table: Drive, part: str, content: bytes, schedule: list[bytes]) -> list[list[float]]:
    """Rows of an FMU that goes on from a state that another process has written down; a job of the guard."""
    plan = planned(table)
    description = plan.parts[part]
    inputs, outputs = _excitation(plan, part), _watched(plan, part, description)
    instance = opened(part or "drive", description, plan.folder(part), plan.settings[part], inputs, SETUP)
    try:
        state = instance.deserialized(content)
        instance.set_state(state)
        instance.forget(state.value)
        for array, saved in zip(instance.schedule, schedule, strict=True):
            array[...] = np.frombuffer(saved, dtype=array.dtype)
        rows: list[list[float]] = _exercised(instance, inputs, outputs, TICKS, LONGER).tolist()
        return rows
    finally:
        instance.close()


def _exercised(
    instance: Instance, inputs: list[Setting], outputs: list[Variable], first: int = 0, count: int = TICKS
) -> np.ndarray:
    """Outputs (ticks, values) over `count` steps from tick `first` on."""
    rows = []
    for k in range(first, first + count):
        instance.write(inputs)
        instance.advance(k * TICK, TICK)
        rows.append(instance.read(outputs))
    return np.array(rows)


def _excitation(plan: DrivePlan, part: str) -> list[Setting]:
    """Held values, in the FMU's own units, of those inputs of `part` that the drive contract feeds."""
    loop = plan.table.velocity_loop
    wanted = {
        "omega_ref": SPEED_IN_USE,
        "tau_load": LOAD_IN_USE,
        "command": SHARE_OF_LIMIT * loop.limit if loop else 0.0,
    }
    return [
        (b.variable, (wanted[b.port.name] - b.offset) / b.gain)
        for b in plan.bindings
        if b.port.name in wanted and belongs(part, b.name) and not b.variable.clocks
    ]


def _watched(plan: DrivePlan, part: str, description: FmuDescription) -> list[Variable]:
    """The outputs of `part`, and whatever else of it plays a role."""
    roles = [b.variable for b in plan.bindings if b.role.causality == "output" and belongs(part, b.name)]
    # what a clock updates can only be read while that ticks
    return [v for v in {v.name: v for v in (*roles, *description.offered("output"))}.values() if not v.clocks]


@dataclass(frozen=True)
class BenchCurves:
    """What the findings were read from; None where the drive failed.

    Attributes:
        cycle: rest, a step of the command, a step of the load.
        overload: the load grows until the shaft stalls.
        frequencies, gain: Hz and speed over command (n,); empty where the drive failed.
    """

    cycle: Response | None = None
    overload: Response | None = None
    frequencies: Curve = field(default_factory=lambda: np.zeros(0))
    gain: Curve = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Qualification:
    """A drive, judged.

    Attributes:
        plan: the drive.
        checks, measures: all of `definitions.CHECKS` that could be made, and all of `definitions.MEASURES`.
        curves: behind them.
        doubts: sentences on measures that suggest another unit of the load.
    """

    plan: DrivePlan
    checks: tuple[Check, ...]
    measures: tuple[Measure, ...]
    curves: BenchCurves
    doubts: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that disqualify the drive."""
        return tuple(check.name for check in self.checks if check.verdict == "FAIL")

    def value(self, name: str) -> float | None:
        """Of the measure `name`; None: not measurable."""
        return next(measure.value for measure in self.measures if measure.name == name)

    def facts(self) -> dict[str, Any]:
        """Everything but the curves, for JSON; SI units."""
        return {
            "drive": self.plan.label,
            **({"sha256": self.plan.system.sha256} if self.plan.system else {}),
            "qualified": not self.failed,
            "failed": list(self.failed),
            "command": self.plan.table.command,
            "fmus": [
                {
                    "part": part,
                    "file": fmu.path.name,
                    "sha256": fmu.sha256,
                    "fmi_version": fmu.model.fmiVersion,
                    "standard": fmu.standard,
                    "kind": fmu.kind,
                    "solver": solver.method if (solver := self.plan.solver(part)) else None,
                }
                for part, fmu in self.plan.parts.items()
            ],
            "checks": {
                check.name: {"verdict": check.verdict, "detail": check.detail, "meaning": CHECKS[check.name]}
                for check in self.checks
            },
            "measures": {
                measure.name: {"value": measure.value, "remark": measure.remark, **MEASURES[measure.name]._asdict()}
                for measure in self.measures
            },
            "warnings": [*self.plan.warnings(), *self.doubts],
        }


def qualified(table: Drive, apart: bool = False) -> Qualification:
    """Run a drive through the whole qualification, in this process: an FMU that crashes takes the process with it.

    Args:
        table: the drive.
        apart: checks of what no experiment needs have processes of their own, and no instance is freed in this one,
            which will not need its memory any more: some FMUs crash then.

    Raises:
        InputRefused: the drive is refused before anything runs: FMU, mapping, parameters, or it does not load.
    """
    plan, attempts = planned(table), Attempts()
    with instances_left() if apart else nullcontext():
        cycle = attempts.made(lambda: response(plan, *work_cycle()))
        if cycle is None:
            return _judged(plan, attempts, BenchCurves())
        swept = attempts.made(lambda: motion.frequency_response(plan))
        stalled = attempts.made(lambda: overload(plan))
        attempts.found(lambda: motion.direction_findings(plan, cycle))
        attempts.found(lambda: motion.load_findings(plan, cycle))
        attempts.found(lambda: motion.repetition_findings(plan, cycle))
        attempts.found(lambda: lifecycle_findings(plan, apart))
        attempts.found(lambda: [*motion.step_findings(cycle), motion.step_error(plan, cycle)])
        if swept:
            steady_gain = cycle.mean_speed(LOADED - AVERAGE, LOADED) / SPEED_IN_USE
            attempts.findings.append(motion.bandwidth(*swept, steady_gain))
        if stalled:
            attempts.found(lambda: [motion.stall_torque(plan, stalled)])
        done = _judged(plan, attempts, BenchCurves(cycle, stalled, *(swept or ())))
        return replace(done, doubts=tuple(attempts.made(lambda: list(_unit_doubts(done))) or ()))


def _unit_doubts(done: Qualification) -> Iterator[str]:
    """Sentences on droop and stall torque that are not of the size of a drive's: its load may be in another unit.

    Raises:
        ComponentFailed: the drive failed under a load that was held.
    """
    load = next((b for b in done.plan.bindings if b.port.name == LOAD.port.name), None)
    if load is None:
        return
    unit = f"in {load.variable.unit}" if load.variable.unit else "without a unit"
    cure = f'; if it is in N mm, map {LOAD.port.name} = "{load.mapped_name}[N.mm]"'
    droop, stall = done.value("droop"), done.value("stall_torque")
    if droop is not None and abs(droop) > OFF * DROOP_MOST:
        most = f"of the drives of fmus/ at most {DROOP_MOST:g}"
        yield f"its droop is {droop:.3g} rad/s per N m, {most}; its load is {unit}{cure}"
    if stall is not None and stall < STALLS[0] / OFF:
        yield f"it stalls at {stall:.3g} N m, the drives of fmus/ from {STALLS[0]:g} N m on; its load is {unit}{cure}"
    heavy, known = OFF * STALLS[1], done.curves.overload is not None and not load.variable.unit
    if stall is None and known and motion.carried(done.plan, heavy, AT_ONCE):
        most = f"the drives of fmus/ stall by {STALLS[1]:g} N m"
        yield f"it turns against {heavy:g} N m, {most}; its load is {unit}{cure}"


class Attempts:
    """Findings so far; a drive that fails in one run is still tried in the next."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self.failures: list[str] = []

    def made(self, run: Callable[[], T]) -> T | None:
        """What `run` returns; None, and a failure kept, if the drive failed in it."""
        try:
            return run()
        except ComponentFailed as failure:
            self.failures.append(str(failure))
            return None

    def found(self, examination: Callable[[], Sequence[Finding]]) -> None:
        """Keep what `examination` finds."""
        self.findings += self.made(examination) or ()


def _judged(plan: DrivePlan, attempts: Attempts, curves: BenchCurves) -> Qualification:
    """Everything in the order of the definitions."""
    roles = ", ".join(binding.port.name for binding in plan.bindings)
    axes = "; three axes commanded alike, the first measured" if plan.axes == 3 else ""
    failures = list(dict.fromkeys(attempts.failures))
    findings = [
        Check("contract", "ok", roles + axes),
        Check("runs", "FAIL" if failures else "ok", " ".join(failures) or "no error, no NaN"),
        *attempts.findings,
    ]
    found = {finding.name: finding for finding in findings}
    checks = [found[name] for name in CHECKS if name in found]
    measures = [found.get(name, Measure(name, None, "the drive failed before")) for name in MEASURES]
    return Qualification(
        plan=plan,
        checks=tuple(c for c in checks if isinstance(c, Check)),
        measures=tuple(m for m in measures if isinstance(m, Measure)),
        curves=curves,
    )
