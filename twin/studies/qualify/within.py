"""What a drive does within its steps, where it can be read there: what no recording at ticks shows."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256

from twin.cosim.component import Component
from twin.cosim.subsystem import Subsystem
from twin.drive.component import FmuComponent
from twin.drive.steps import read_within
from twin.errors import ComponentFailed
from twin.experiment.schema import Drive
from twin.runs.assembly.drives import ALONE, DrivePlan, planned, qualified
from twin.runs.guard.guard import JobEnded, JobEndedLoading, guarded
from twin.runs.guard.reporter import Reporter
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Check, judged
from twin.studies.qualify.work_cycle import work_cycle

JOB = "twin.studies.qualify.within:examined"


@dataclass(frozen=True)
class Excursion:
    """Of one output, within the steps of a work cycle.

    Attributes:
        output: its role, or else what the user calls the variable.
        unit: of `beyond`: SI for a role, else what the FMU states.
        beyond: by how much it goes beyond what it is at both ends of a step at most.
        t: when (s); None: it never does.
        reads: how often it is read, per step.
    """

    output: str
    unit: str
    beyond: float
    t: float | None
    reads: float


def offers_within(plan: DrivePlan) -> bool:
    """Whether a drive has outputs that can be read within a step."""
    return any(read_within(description) for description in plan.parts.values())


def within_check(plan: DrivePlan, cycle: Response, apart: bool) -> tuple[Check, tuple[Excursion, ...]]:
    """Check `within` and what stands behind it; a work cycle of its own, so that no other finding depends on it.

    Args:
        plan: a drive that offers it.
        cycle: its work cycle, in which nothing was read within a step.
        apart: in a process of its own: an FMU that crashes there costs that check, and nothing else.
    """
    try:
        told = guarded(JOB, {"table": plan.table}) if apart else watched(plan)
    except (ComponentFailed, JobEnded, JobEndedLoading) as failure:
        return judged("within", False, str(failure), otherwise="note"), ()
    found = tuple(Excursion(**fields) for fields in told["excursions"])
    said = _said(found)
    if told["digest"] != _digest(cycle):
        return judged("within", False, f"{said}; being read changes theta_m or omega_m", otherwise="note"), found
    return judged("within", any(one.reads for one in found), said, otherwise="note"), found


def examined(reporter: Reporter, table: Drive) -> dict:
    """See `watched`; a job of the guard."""
    return watched(planned(table))


def watched(plan: DrivePlan) -> dict:
    """A work cycle whose outputs are read within its steps: fields of each `Excursion`, and a digest of the motion.

    Raises:
        ComponentFailed: the drive failed.
    """
    found: list[Excursion] = []
    done = response(
        replace(plan, watched=True), *work_cycle(), look=lambda drive: found.extend(_excursions(plan, drive))
    )
    return {"excursions": [asdict(one) for one in found], "digest": _digest(done)}


def _digest(done: Response) -> str:
    return sha256(done.theta_m.tobytes() + done.omega_m.tobytes()).hexdigest()


def _said(found: Sequence[Excursion]) -> str:
    reads = max(one.reads for one in found)
    if not reads:
        return "never read: it has outputs that can be, and no finished update within a step comes"
    far = [f"{one.output} by up to {one.beyond:.3g} {one.unit} at {one.t:.4f} s" for one in found if one.t is not None]
    still = [one.output for one in found if one.t is None]
    words = [*far, *([f"{', '.join(still)} not at all"] if still else [])]
    often = f"{reads:.3g} update{'s' * (reads != 1.0)} a step"
    return f"beyond what it is at both ends of a step: {'; '.join(words)}. {often}"


def _excursions(plan: DrivePlan, drive: Component) -> Iterator[Excursion]:
    roles = {b.name: b for b in plan.bindings}
    for fmu in _fmus(drive):
        part = fmu.name if fmu.name in plan.parts else ALONE
        for one in fmu.strays:
            name, index = qualified(part, one.variable.name), one.name.removeprefix(one.variable.name)
            role = roles.get(name)
            unit, scale = (role.port.unit, abs(role.gain)) if role else (one.variable.unit or "1", 1.0)
            output = (role.port.name if role else name) + index
            yield Excursion(output, unit, scale * one.beyond, one.t if one.beyond > 0.0 else None, one.reads)


def _fmus(component: Component) -> Iterator[FmuComponent]:
    if isinstance(component, FmuComponent):
        yield component
    elif isinstance(component, Subsystem):
        for inner in component.system.components:
            yield from _fmus(inner)
