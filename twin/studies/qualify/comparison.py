"""The same experiment with one drive after the other, judged on what is true."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import ComponentFailed
from twin.experiment.experiment import Experiment
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import simulate
from twin.runs.trace import Trace
from twin.studies.metrics.requirement import Standing, overall, standing
from twin.studies.qualify.definitions import Measure
from twin.studies.qualify.true_run import COMPARED, TrueRun
from twin.studies.steps import Say, Steps, silent


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


@dataclass(frozen=True)
class DriveTrials:
    """An experiment with one drive after the other.

    Attributes:
        name: of the experiment.
        trials: of each drive.
    """

    name: str
    trials: tuple[DriveTrial, ...]

    def standings(self) -> dict[str, Standing]:
        """Each drive but the first beside the first, by name; none that failed, nor of a first that did."""
        first = self.trials[0]
        return {
            trial.name: standing(_judged(trial), _judged(first))
            for trial in self.trials[1:]
            if not trial.failure and not first.failure
        }


def trials(
    experiments: Sequence[Path],
    drives: Sequence[str],
    settings: Sequence[str] = (),
    body: str | None = None,
    say: Say = silent,
) -> tuple[DriveTrials, ...]:
    """Run each of `experiments` with each of `drives` in all three joints, in this process.

    Args:
        experiments: files.
        drives: see `load_experiment`.
        settings, body: see `load_experiment`; of all experiments.
        say: told which one is on.

    Raises:
        InputRefused: an experiment or a drive has a mistake; no experiment has been run.
    """
    loaded = [[load_experiment(path, settings, drive, body) for drive in drives] for path in experiments]
    for one in (one for row in loaded for one in row):
        assemble(one).close()
    done, steps = [], Steps(say, len(experiments) * len(drives))
    for path, row in zip(experiments, loaded, strict=True):
        found = []
        for one, drive in zip(row, drives, strict=True):
            steps.next(f"{path.stem} with {drive}")
            found.append(_trial(one, drive))
        done.append(DriveTrials(path.stem, tuple(found)))
    return tuple(done)


def verdict(compared: Sequence[DriveTrials]) -> list[str]:
    """A sentence for each drive but the first, over all experiments, and one for each that failed."""
    first = compared[0].trials[0].name
    by_drive: dict[str, list[Standing]] = {}
    for one in compared:
        for name, its in one.standings().items():
            by_drive.setdefault(name, []).append(its)
    said = [overall(standings).sentence(name, first) for name, standings in by_drive.items()]
    failed = {
        f"{t.name} failed in {one.name}, and is not judged there" for one in compared for t in one.trials if t.failure
    }
    return said + sorted(failed)


def comparison_facts(compared: DriveTrials) -> dict[str, Any]:
    """Everything but the curves, for JSON; SI units."""
    done = compared.trials
    return {
        "experiment": compared.name,
        "drives": [
            {
                "drive": trial.name,
                "failure": trial.failure,
                "measures": {m.name: {"value": m.value, "remark": m.remark} for m in trial.measures},
            }
            for trial in done
        ],
    }


def _judged(trial: DriveTrial) -> dict[str, float | None]:
    """What a drive is judged by, by the name of the table; what its model costs this computer says nothing of it."""
    return {COMPARED[m.name].text: m.value for m in trial.measures if m.name != "cost"}


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
