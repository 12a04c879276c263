"""Whether the drives of a sweep may be used again through reset: what their qualification says, found out at the start.

Source of the check: `twin.studies.qualify.lifecycle`, FMI 2.0.4 section 2.1.6, FMI 3.0 section 2.3.1.
"""

from pathlib import Path

from twin.errors import InputRefused
from twin.runs.guard.guard import guarded
from twin.runs.guard.limits import Limits
from twin.runs.guard.reporter import Reporter
from twin.studies.sweep.plan import Plan, Task, texts

JOB = "twin.studies.sweep.reset:problems"


def refuse_unproved(plan: Plan, limits: Limits) -> None:
    """Check every drive of a sweep that says reuse = "reset", in a process of its own.

    Raises:
        InputRefused: a run after a reset is not, bit for bit, that of a new instance.
    """
    if plan.definition.reuse is None:
        return
    # runs that share these share their FMUs
    tasks: dict[object, Task] = {(task.drive, texts(task.settings)): task for task in reversed(plan.tasks)}
    runs = [[task.drive, task.settings] for task in tasks.values()]
    found = guarded(JOB, {"experiment": str(plan.experiment.absolute()), "runs": runs}, limits)
    if found:
        raise InputRefused("\n".join(f'{plan.name}: reuse = "reset": {problem}' for problem in dict.fromkeys(found)))


def problems(reporter: Reporter, experiment: str, runs: list[tuple[str | None, list[str]]]) -> list[str]:
    """A sentence for every drive that must not be used again.

    Args:
        experiment: its file.
        runs: (drive, settings) for `load_experiment`.
    """
    from twin.runs.assembly.drives import planned
    from twin.runs.assembly.load import load_experiment
    from twin.studies.qualify.lifecycle import reset_finding

    told = []
    reporter.loading()
    for drive, settings in runs:
        tables = {table.model_dump_json(): table for table in load_experiment(Path(experiment), settings, drive).drives}
        for plan in map(planned, tables.values()):
            finding = reset_finding(plan)
            if finding.verdict != "ok":
                told.append(f"{plan.label}: {finding.detail}; leave reuse out, and each run gets new instances")
    return told
