"""The same experiment with one drive after the other, judged on what is true."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import ComponentFailed
from twin.experiment.experiment import Experiment
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import simulate
from twin.runs.trace import Trace
from twin.studies.qualify.definitions import Measure
from twin.studies.qualify.true_run import COMPARED, TrueRun


@dataclass(frozen=True)
class DriveTrial:
    """One drive in the experiment.

    Attributes:
        name: of the drive, as the user said it.
        run: what is true in it, up to the failure if there was one.
        measures: all of `COMPARED`.
        failure: what ended the run early; empty if nothing did.
    """

    name: str
    run: TrueRun
    measures: tuple[Measure, ...]
    failure: str = ""


def trials(
    experiment: Path, drives: list[str], say: Callable[[str], None] = lambda what: None
) -> tuple[DriveTrial, ...]:
    """Run `experiment` with each of `drives` in all three joints, in this process; `say` is told which one is on.

    Raises:
        InputRefused: the experiment or a drive has a mistake; no experiment has been run.
    """
    experiments = [load_experiment(experiment, (), drive) for drive in drives]
    for loaded in experiments:
        assemble(loaded).close()
    done: list[DriveTrial] = []
    for loaded, drive in zip(experiments, drives, strict=True):
        say(f"{drive}, {len(done) + 1} of {len(drives)}")
        done.append(_trial(loaded, drive))
    return tuple(done)


def comparison_facts(experiment: Path, done: tuple[DriveTrial, ...]) -> dict[str, Any]:
    """Everything but the curves, for JSON; SI units."""
    return {
        "experiment": experiment.stem,
        "definitions": {name: definition._asdict() for name, definition in COMPARED.items()},
        "drives": [
            {
                "drive": trial.name,
                "failure": trial.failure,
                "measures": {m.name: {"value": m.value, "remark": m.remark} for m in trial.measures},
            }
            for trial in done
        ],
    }


def _trial(experiment: Experiment, name: str) -> DriveTrial:
    trace = Trace()
    try:
        with assemble(experiment) as assembly:
            done = simulate(assembly, experiment.duration_ticks, [trace], timed=True).completed()
    # also one that crashes when it is freed, if it has a process of its own
    except ComponentFailed as failure:
        lost = tuple(Measure(measure, None, "the run failed") for measure in COMPARED)
        return DriveTrial(name, TrueRun(trace), lost, str(failure))
    run = TrueRun(trace)
    return DriveTrial(name, run, run.measures(sum(cost for c, cost in done.costs.items() if c.startswith("drive"))))
