"""The qualification run: every check and measure of one drive."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.fmi.component import defer_release, instance_class, mark_stateless
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.variable import Setting, Setup, Variable
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.reporter import Reporter
from twin.robot.assembly.drives import DrivePlan, belongs, plan_drive
from twin.robot.drive.contract import LOAD_ROLE
from twin.robot.experiment.schema import Drive
from twin.studies.metrics.response import Curve
from twin.studies.qualify import motion
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import (
    AVERAGE_TIME,
    CHECK_MEANINGS,
    LOAD_IN_USE,
    LOAD_TIME,
    MAX_DROOP,
    MEASURE_DEFINITIONS,
    SPEED_IN_USE,
    STALL_RANGE,
    TICK,
    UNIT_ERROR_FACTOR,
    Check,
    Finding,
    Measure,
    make_check,
    work_cycle,
)
from twin.studies.qualify.motion import overload

STEP_LOAD_RATE = 1e4
"""Rate of an almost instantaneous load (N m/s)."""
CHECK_JOB = "twin.studies.qualify.qualification:check_fields"
EXERCISE_TICKS, STATE_TICKS = 50, 500
"""Ticks before a state is saved, long enough for every sampled loop inside, and ticks compared after it is restored."""
CHECK_SETUP = Setup(stop=(EXERCISE_TICKS + STATE_TICKS) * TICK, step=TICK)
COMMAND_SHARE = 0.1
"""Command of a drive that takes no speed, as a share of the velocity loop's limit."""
OTHER_FUTURE = "it continues differently from a restored state; twin treats it as stateless"
CONTINUE_JOB = "twin.studies.qualify.qualification:continue_from_state"
T = TypeVar("T")


class _Specimen(NamedTuple):
    """An instance of a drive part's FMU, constant values of its inputs, and its readable outputs."""

    plan: DrivePlan
    part: str
    instance: Instance
    inputs: list[Setting]
    outputs: list[Variable]

    def exercise(self, first: int = 0, count: int = EXERCISE_TICKS) -> np.ndarray:
        """Advance the FMU by `count` steps from tick `first` on and return its outputs (ticks, values)."""
        rows = []
        for k in range(first, first + count):
            self.instance.write(self.inputs)
            self.instance.advance(k * TICK, TICK)
            rows.append(self.instance.read_floats(self.outputs))
        return np.array(rows)

    def continuation(self) -> np.ndarray:
        """Return the outputs of the steps after those before which a state is saved."""
        return self.exercise(EXERCISE_TICKS, STATE_TICKS)


@contextmanager
def _specimen(plan: DrivePlan, part: str) -> Iterator[_Specimen]:
    description, inputs = plan.parts[part], _excitation(plan, part)
    outputs = _readable_outputs(plan, part, description)
    make = instance_class(description)
    instance = make(part or "drive", description, plan.folder(part), plan.settings[part], inputs, CHECK_SETUP)
    try:
        yield _Specimen(plan, part, instance, inputs, outputs)
    finally:
        instance.close()


def lifecycle_findings(plan: DrivePlan, apart: bool) -> list[Finding]:
    """Check reset, saved state and serialised state of each FMU of a drive separately.

    An FMU that continues differently from its restored state is marked as stateless. `apart`: each check has a process
    of its own, so that a crash of an FMU costs only that check.
    """
    return [_isolate_check(plan, name) if apart else _bookkeeping_check(name, plan) for name in CHECK_FUNCTIONS]


def check_fields(reporter: Reporter, table: Drive, name: str) -> dict[str, str]:
    return asdict(_bookkeeping_check(name, plan_drive(table)))


def _isolate_check(plan: DrivePlan, name: str) -> Check:
    try:
        return Check(**run_guarded(CHECK_JOB, {"table": plan.table, "name": name}))
    except (JobFailure, JobLoadFailure) as failure:
        return make_check(name, False, str(failure), otherwise="note")


def _bookkeeping_check(name: str, plan: DrivePlan) -> Check:
    problems, found = [], dict[str, str]()
    for part, description in plan.parts.items():
        with _specimen(plan, part) as specimen:
            try:
                problem = CHECK_FUNCTIONS[name](specimen)
                if name != "reset" and problem in ("", OTHER_FUTURE):
                    found[description.sha256] = found.get(description.sha256, "") or problem
            except TwinError as refusal:
                problem = str(refusal)
        if problem:
            problems.append(f"{part}: {problem}" if part else problem)
    for sha256, problem in found.items():
        if problem or name == "state":
            mark_stateless(sha256, problem)
    return make_check(name, not problems, "; ".join(problems) or "bit for bit", otherwise="note")


def _reset_problem(tried: _Specimen) -> str:
    """Check that an FMU runs identically after a reset; return an error message or ""."""
    first = tried.exercise()
    tried.instance.reset()
    return "" if np.array_equal(first, tried.exercise()) else "a run after reset is another one"


def _state_problem(tried: _Specimen) -> str:
    """Check that an FMU saves and restores its state; return an error message or ""."""
    instance = tried.instance
    if not instance.description.interface.canGetAndSetFMUstate:
        return "not offered"
    tried.exercise()
    state, schedule = instance.save_state(), [array.copy() for array in instance.schedule]
    onward = tried.continuation()
    instance.restore_state(state)
    instance.free_state(state.value)
    for array, saved in zip(instance.schedule, schedule, strict=True):
        array[...] = saved
    return "" if np.array_equal(onward, tried.continuation()) else OTHER_FUTURE


def _serialization_problem(tried: _Specimen) -> str:
    """Check that another process can continue from an FMU's serialised state; return an error message or ""."""
    instance = tried.instance
    if not instance.description.interface.canSerializeFMUstate:
        return "not offered"
    if instance.description.kind == "model_exchange":
        return "not tried: its solver holds a part of the state"
    tried.exercise()
    state = instance.save_state()
    content = instance.serialize_state(state)
    instance.free_state(state.value)
    schedule = [array.tobytes() for array in instance.schedule]
    onward = tried.continuation()
    asked = {"table": tried.plan.table, "part": tried.part, "content": content, "schedule": schedule}
    return "" if np.array_equal(onward, run_guarded(CONTINUE_JOB, asked)) else OTHER_FUTURE


CHECK_FUNCTIONS: dict[str, Callable[[_Specimen], str]] = {
    "reset": _reset_problem,
    "state": _state_problem,
    "written": _serialization_problem,
}


def continue_from_state(
    reporter: Reporter, table: Drive, part: str, content: bytes, schedule: list[bytes]
) -> list[list[float]]:
    """Continue an FMU in this process from a state serialised by another process, and return its outputs."""
    with _specimen(plan_drive(table), part) as tried:
        state = tried.instance.deserialize_state(content)
        tried.instance.restore_state(state)
        tried.instance.free_state(state.value)
        for array, saved in zip(tried.instance.schedule, schedule, strict=True):
            array[...] = np.frombuffer(saved, dtype=array.dtype)
        rows: list[list[float]] = tried.continuation().tolist()
        return rows


def _excitation(plan: DrivePlan, part: str) -> list[Setting]:
    """Return constant values, in the FMU's own units, for a drive part's inputs."""
    loop = plan.table.velocity_loop
    wanted = {
        "omega_ref": SPEED_IN_USE,
        "tau_load": LOAD_IN_USE,
        "command": COMMAND_SHARE * loop.limit if loop else 0.0,
    }
    return [
        (b.variable, (wanted[b.port.name] - b.offset) / b.gain)
        for b in plan.bindings
        if b.port.name in wanted and belongs(part, b.name) and not b.variable.clocks
    ]


def _readable_outputs(plan: DrivePlan, part: str, description: FmuDescription) -> list[Variable]:
    """Return the outputs of a drive part's FMU, and its other variables that have a role."""
    roles = [b.variable for b in plan.bindings if b.role.causality == "output" and belongs(part, b.name)]
    # Variables updated by a clock can only be read while it ticks.
    return [v for v in {v.name: v for v in (*roles, *description.variables_of("output"))}.values() if not v.clocks]


@dataclass(frozen=True)
class BenchCurves:
    """Responses of a drive to the work cycle and to a load that grows until it stalls, and its frequency response.

    Attributes:
        frequencies, gain: frequencies (Hz) and speed over command (n,); all are empty or None where the drive failed.
    """

    cycle: Response | None = None
    overload: Response | None = None
    frequencies: Curve = field(default_factory=lambda: np.zeros(0))
    gain: Curve = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Qualification:
    """Judgement of a drive by all checks and measures, and doubts on the load's unit, a sentence each."""

    plan: DrivePlan
    checks: tuple[Check, ...]
    measures: tuple[Measure, ...]
    curves: BenchCurves
    doubts: tuple[str, ...] = ()

    @property
    def failed_checks(self) -> tuple[str, ...]:
        return tuple(check.name for check in self.checks if check.verdict == "FAIL")

    def value(self, name: str) -> float | None:
        """Return the value of one of the drive's measures; None if it cannot be measured."""
        return next(measure.value for measure in self.measures if measure.name == name)

    def to_dict(self) -> dict[str, Any]:
        return {
            "drive": self.plan.label,
            **({"sha256": self.plan.system.sha256} if self.plan.system else {}),
            "qualified": not self.failed_checks,
            "failed": list(self.failed_checks),
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
                check.name: {"verdict": check.verdict, "detail": check.detail, "meaning": CHECK_MEANINGS[check.name]}
                for check in self.checks
            },
            "measures": {
                measure.name: {
                    "value": measure.value,
                    "remark": measure.remark,
                    **MEASURE_DEFINITIONS[measure.name]._asdict(),
                }
                for measure in self.measures
            },
            "warnings": [*self.plan.warnings(), *self.doubts],
        }


def qualify_drive(table: Drive, apart: bool = False) -> Qualification:
    """Qualify a drive by all checks and measures, in this process; refuse it before anything runs if it does not fit.

    Args:
        apart: whether checks that no experiment needs have processes of their own. Instances are then not freed in this
            process, since some FMUs crash when freed and the process ends anyway.
    """
    plan, attempts = plan_drive(table), Attempts()
    with defer_release() if apart else nullcontext():
        cycle = attempts.attempt(lambda: response(plan, *work_cycle()))
        if cycle is None:
            return _qualification(plan, attempts, BenchCurves())
        swept = attempts.attempt(lambda: motion.frequency_response(plan))
        stalled = attempts.attempt(lambda: overload(plan))
        attempts.collect(lambda: motion.direction_findings(plan, cycle))
        attempts.collect(lambda: motion.load_findings(plan, cycle))
        attempts.collect(lambda: motion.repetition_findings(plan, cycle))
        attempts.collect(lambda: lifecycle_findings(plan, apart))
        attempts.collect(lambda: [*motion.step_findings(cycle), motion.step_error(plan, cycle)])
        if swept:
            steady_gain = cycle.mean_speed(LOAD_TIME - AVERAGE_TIME, LOAD_TIME) / SPEED_IN_USE
            attempts.findings.append(motion.bandwidth(*swept, steady_gain))
        if stalled:
            attempts.collect(lambda: [motion.stall_torque(plan, stalled)])
        done = _qualification(plan, attempts, BenchCurves(cycle, stalled, *(swept or ())))
        return replace(done, doubts=tuple(attempts.attempt(lambda: list(_unit_doubts(done))) or ()))


def _unit_doubts(done: Qualification) -> Iterator[str]:
    """Yield sentences on implausible droop and stall torque, which suggest that a drive's load has another unit."""
    load = next((b for b in done.plan.bindings if b.port.name == LOAD_ROLE.port.name), None)
    if load is None:
        return
    unit = f"in {load.variable.unit}" if load.variable.unit else "without a unit"
    cure = f'; if it is in N mm, map {LOAD_ROLE.port.name} = "{load.mapped_name}[N.mm]"'
    droop, stall = done.value("droop"), done.value("stall_torque")
    if droop is not None and abs(droop) > UNIT_ERROR_FACTOR * MAX_DROOP:
        most = f"of the drives of fmus/ at most {MAX_DROOP:g}"
        yield f"its droop is {droop:.3g} rad/s per N m, {most}; its load is {unit}{cure}"
    if stall is not None and stall < STALL_RANGE[0] / UNIT_ERROR_FACTOR:
        least = f"the drives of fmus/ from {STALL_RANGE[0]:g} N m on"
        yield f"it stalls at {stall:.3g} N m, {least}; its load is {unit}{cure}"
    heavy, known = UNIT_ERROR_FACTOR * STALL_RANGE[1], done.curves.overload is not None and not load.variable.unit
    if stall is None and known and motion.carries_load(done.plan, heavy, STEP_LOAD_RATE):
        most = f"the drives of fmus/ stall by {STALL_RANGE[1]:g} N m"
        yield f"it turns against {heavy:g} N m, {most}; its load is {unit}{cure}"


class Attempts:
    """Collector of a qualification's findings and failures; a drive that fails in one run is tried in the next."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self.failures: list[str] = []

    def attempt(self, run: Callable[[], T]) -> T | None:
        """Return the result of a run of the drive; None, and the failure recorded, if the drive failed."""
        try:
            return run()
        except ComponentFailed as failure:
            self.failures.append(str(failure))
            return None

    def collect(self, examination: Callable[[], Sequence[Finding]]) -> None:
        """Add the findings of an examination of the drive; a failure of the drive is recorded instead."""
        self.findings += self.attempt(examination) or ()


def _qualification(plan: DrivePlan, attempts: Attempts, curves: BenchCurves) -> Qualification:
    roles = ", ".join(binding.port.name for binding in plan.bindings)
    axes = "; three axes commanded alike, the first measured" if plan.axes == 3 else ""
    failures = list(dict.fromkeys(attempts.failures))
    findings = [
        Check("contract", "ok", roles + axes),
        Check("runs", "FAIL" if failures else "ok", " ".join(failures) or "no error, no NaN"),
        *attempts.findings,
    ]
    found = {finding.name: finding for finding in findings}
    checks = [found[name] for name in CHECK_MEANINGS if name in found]
    measures = [found.get(name, Measure(name, None, "the drive failed before")) for name in MEASURE_DEFINITIONS]
    return Qualification(
        plan=plan,
        checks=tuple(c for c in checks if isinstance(c, Check)),
        measures=tuple(m for m in measures if isinstance(m, Measure)),
        curves=curves,
    )
