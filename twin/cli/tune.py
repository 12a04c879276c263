"""`twin tune`: gains for given goals."""

import math
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.completion import experiment_files
from twin.cli.job import finished
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, Isolate, Settings
from twin.writing import json_text, made_folder, write_json, write_text

FACTS, PICTURE, GAINS = "tuning.json", "tuning.png", "tuned.toml"


def tune(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment file (TOML) or name.", autocompletion=experiment_files),
    ],
    margin: Annotated[float, typer.Option("--margin", metavar="M_S", help="Largest |1/(1+L)| of any loop.")] = 1.6,
    overshoot: Annotated[
        float, typer.Option("--overshoot-percent", metavar="PERCENT", help="Largest overshoot of a step.")
    ] = 5.0,
    bandwidth: Annotated[
        float | None,
        typer.Option("--bandwidth-Hz", metavar="HZ", help="Least bandwidth, of force if it is controlled."),
    ] = None,
    stiffness: Annotated[
        str | None, typer.Option("--stiffness-N-per-m", metavar="LOW:HIGH", help="Stiffness of what is pressed on.")
    ] = None,
    drive: Annotated[
        list[str] | None, typer.Option(metavar="FMU", help="A drive they have to do for; may be repeated.")
    ] = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where gains, picture, JSON go: results/tuning/EXPERIMENT.")
    ] = None,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Find the fastest gains that keep a margin and an overshoot everywhere.

    Searched on the linear model at every place, stiffness and drive, then
    tried in the co-simulation. The experiment's file is left as it is:
    tuned.toml extends it. Exit code: 0 goals met and confirmed, 1 they are
    not (the best found is told), 2 input refused or no linear model, 3 a
    drive failed, crashed or hung.

    Example: twin tune experiments/fig4_force_position.toml
    """
    folder = made_folder(out or Path("results/tuning") / experiment.stem)
    arguments: dict[str, Any] = {
        "experiment": str(experiment),
        "goals": {
            "sensitivity": margin,
            "overshoot": overshoot / 100.0,
            "bandwidth": None if bandwidth is None else 2.0 * math.pi * bandwidth,
        },
        "stiffness": stiffness,
        "drives": drive or [None],
        "body": body,
        "settings": settings or [],
        "out": str(folder),
    }
    facts, text = finished(tuned_loops, arguments, isolate)
    print(json_text(facts) if as_json else "\n".join([text, "", *(f"  {file}" for file in facts["files"])]))
    if not facts["met"]:
        raise SystemExit(1)


def tuned_loops(
    voice: Any,
    experiment: str,
    goals: dict[str, Any],
    stiffness: str | None,
    drives: list[str | None],
    body: str | None,
    settings: list[str],
    out: str,
) -> tuple[dict[str, Any], str]:
    """(facts for JSON, text) of the gains found, and the files of `out`; a job of the guard."""
    from twin.experiment.named import experiment_file
    from twin.runs.assembly.load import load_experiment
    from twin.studies.tune.fragment import fragment
    from twin.studies.tune.goals import Goals, stiffness_range
    from twin.studies.tune.picture import draw_tuning
    from twin.studies.tune.text import tuning_text
    from twin.studies.tune.tuned import tuned

    file, folder = experiment_file(experiment), Path(out)
    asked, span = Goals(**goals), None if stiffness is None else stiffness_range(stiffness)
    # of several drives the file's own stays
    one = [] if len(drives) > 1 else [("--drive", drives[0])]
    given = [*one, ("--body", body), *(("--set", setting) for setting in settings)]
    options = [word for option, value in given if value is not None for word in (option, value)]
    done = tuned([load_experiment(file, settings, drive, body) for drive in dict.fromkeys(drives)], asked, span)
    again = shlex.join(["twin", "run", str(folder / GAINS), *options])
    facts = done.facts() | {"files": [str(folder / name) for name in (GAINS, PICTURE, FACTS)], "again": again}
    write_text(folder / GAINS, fragment(done, file, folder, options))
    draw_tuning(done, folder / PICTURE)
    write_json(folder / FACTS, facts)
    return facts, "\n".join([tuning_text(done), f"next  {again}"])
