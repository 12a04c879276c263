"""Whether a drive repeats itself, how much the step size matters, and what a step costs."""

from dataclasses import replace

import numpy as np

from twin.errors import ComponentFailed, InputRefused
from twin.experiment.schema import Drive, Part
from twin.runs.assembly.drives import DrivePlan
from twin.runs.assembly.rates import rates
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Check, Finding, Measure, judged
from twin.studies.qualify.operating_range import RESOLUTION, TICK
from twin.studies.qualify.work_cycle import work_cycle

USUAL_TOLERANCE = 1e-4
"""Relative, of the solver in an FMU that states none; what Dymola and OpenModelica export with is 1e-4 and 1e-6."""
TIGHTER = 0.01
NOBODY_SEES = 0.01 * RESOLUTION
"""rad. An error of the solver below it is not worth a word."""


def repetition_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check `repeats`, measure `cost`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in the second or third run.
    """
    again = [response(plan, *work_cycle()) for _ in range(2)]
    return [
        _repeats(cycle, again[0]),
        Measure("cost", min(run.cost for run in (cycle, *again))),
    ]


def step_error(plan: DrivePlan, cycle: Response) -> Measure:
    """Measure `step_error`: the work cycle once more, the FMU stepped twice as finely, its inputs held as before.

    A solver of ours that goes in steps of one length has them halved, too. And once with a solver that works more
    exactly: no finer step mends what its tolerance does.

    Args:
        plan: the drive.
        cycle: its work cycle.
    """
    steps, _ = rates(plan.label, plan.table, TICK)
    halved = replace(plan, table=_halved(plan.table, steps))
    try:
        finer = response(halved, *work_cycle())
    # an FMU may insist on a step size of its own
    except (ComponentFailed, InputRefused) as refusal:
        return Measure("step_error", None, f"refuses a step of {0.5e3 * TICK / steps:g} ms: {refusal}")
    change = _apart(finer, cycle)
    by_solver, tolerance = _tolerance_error(plan, cycle)
    if by_solver > max(change, NOBODY_SEES):
        return Measure(
            "step_error", change, f"with tolerance = {tolerance:g} it moves by {by_solver:.2g} rad: set that"
        )
    return Measure("step_error", change, "" if change < RESOLUTION else f"seen by the robot's encoder: {_remedy(plan)}")


def _halved(table: Drive, steps: int) -> Drive:
    """The drive of `table`, which makes so many steps per tick, with steps half as long, those of rk4 too."""
    parts = {name: part.model_copy(update=_half_step(part)) for name, part in table.parts.items()}
    return table.model_copy(update={"substeps": 2 * steps, "parts": parts, **_half_step(table)})


def _half_step(table: Drive | Part) -> dict[str, float]:
    return {} if table.solver_step is None else {"solver_step": 0.5 * table.solver_step}


def _remedy(plan: DrivePlan) -> str:
    solvers = [plan.solver(part) for part in plan.parts]
    return "lower solver_step_ms" if any(s and s.method == "rk4" for s in solvers) else "raise substeps"


def _tolerance_error(plan: DrivePlan, cycle: Response) -> tuple[float, float]:
    """(largest change of theta_m in the work cycle, rad; the relative tolerance of its solver that makes it)."""
    stated = [tolerance for part in plan.parts if (tolerance := plan.tolerance(part))]
    tolerance = TIGHTER * min(stated, default=USUAL_TOLERANCE)
    parts = {name: part.model_copy(update={"tolerance": None}) for name, part in plan.table.parts.items()}
    table = plan.table.model_copy(update={"tolerance": tolerance, "parts": parts})
    try:
        exact = response(replace(plan, table=table), *work_cycle())
    # an FMU need not take what nobody has to say
    except (ComponentFailed, InputRefused):
        return 0.0, tolerance
    return _apart(exact, cycle), tolerance


def _apart(one: Response, other: Response) -> float:
    """Largest difference of theta_m (rad)."""
    return float(np.max(np.abs(one.theta_m - other.theta_m)))


def _repeats(one: Response, other: Response) -> Check:
    same = np.array_equal(one.theta_m, other.theta_m) and np.array_equal(one.omega_m, other.omega_m)
    if same:
        return judged("repeats", True, f"bit for bit over {len(one.t)} steps")
    k = int(np.flatnonzero((one.theta_m != other.theta_m) | (one.omega_m != other.omega_m))[0])
    return judged("repeats", False, f"differs from t = {one.t[k]:g} s on, by up to {_apart(one, other):.3g} rad")
