"""Tuning, from an experiment's file to files: gains to run with, picture, facts."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.experiment.named import experiment_file
from twin.runs.assembly.load import load_experiment
from twin.studies.answer import Answer
from twin.studies.steps import Say
from twin.studies.tune.fragment import fragment
from twin.studies.tune.goals import Goals, stiffness_range
from twin.studies.tune.picture import draw_tuning
from twin.studies.tune.schedule import RANGE, scheduled
from twin.studies.tune.schedule_text import schedule_lines, schedule_text
from twin.studies.tune.text import tuning_text
from twin.studies.tune.tuned import tuned
from twin.writing import made_folder, write_json, write_text

HOME = Path("results") / "tuning"
NO_SCHEDULE = "controller.force.schedule=[]"
FACTS, PICTURE, GAINS = "tuning.json", "tuning.png", "tuned.toml"


def tune(
    experiment: Path,
    goals: dict[str, Any],
    stiffness: str | None,
    drives: Sequence[str | None],
    body: str | None,
    settings: Sequence[str],
    out: Path | None,
    schedule: bool,
    say: Say,
) -> Answer:
    """The gains of the laws of an experiment that meet goals, and files in `out`, or results/tuning/EXPERIMENT.

    Exit code 1: they are not met.

    Args:
        experiment: its file or name.
        goals: fields of `Goals`.
        stiffness: see `stiffness_range`.
        drives: with each of which the gains have to do; None: the experiment's own.
        body: see `load_experiment`.
        settings: see `load_experiment`.
        out: folder; None: results/tuning/EXPERIMENT.
        schedule: whether gains over the stiffness are wanted besides, which replace those the experiment has.
        say: told what is being done.

    Raises:
        InputRefused, ComponentFailed: see `tuned`; or the folder cannot be used.
    """
    folder = made_folder(out or HOME / experiment.stem)
    file = experiment_file(experiment)
    wanted, span = Goals(**goals), None if stiffness is None else stiffness_range(stiffness)
    # of several drives the file's own stays
    one = [] if len(drives) > 1 else [("--drive", drives[0])]
    given = [*one, ("--body", body), *(("--set", setting) for setting in settings)]
    options = [word for option, value in given if value is not None for word in (option, value)]
    if schedule:
        span = span or RANGE
        # one set first, which is then the safe one
        settings = [*settings, NO_SCHEDULE]
    done = tuned([load_experiment(file, settings, drive, body) for drive in dict.fromkeys(drives)], wanted, span, say)
    if schedule:
        say("designing the schedule")
    over = scheduled(done) if schedule else None
    files = [str(folder / name) for name in (GAINS, PICTURE, FACTS)]
    again = shlex.join(["twin", "run", str(folder / GAINS), *options])
    facts = done.facts() | {"files": files, "again": again}
    lines, told = fragment(done, file, folder, options), [tuning_text(done)]
    if over is not None:
        lines += schedule_lines(over, done.experiments[0].controller.tissue is not None)
        told += ["", schedule_text(over), ""]
        facts["schedule"] = over.facts()
    write_text(folder / GAINS, lines)
    draw_tuning(done, folder / PICTURE)
    write_json(folder / FACTS, facts)
    text = "\n".join([*told, f"next  {again}", "", *(f"  {file}" for file in files)])
    return Answer(text, facts, 0 if done.met and (over is None or over.met) else 1)
