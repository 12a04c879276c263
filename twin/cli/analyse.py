"""`twin analyse`: the loops of an experiment, linear."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.completion import experiment_files
from twin.cli.job import finished
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, DriveName, Isolate, Settings
from twin.writing import json_text, made_folder, write_json

FACTS, PICTURE, MAP = "analysis.json", "analysis.png", "map.png"


def analyse(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment file (TOML) or name.", autocompletion=experiment_files),
    ],
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where pictures and JSON go: results/analysis/EXPERIMENT.")
    ] = None,
    tried: Annotated[
        bool,
        typer.Option(
            "--try/--no-try",
            help="Try the gain limits in the co-simulation; look there for those that do not hold.",
        ),
    ] = True,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Tell how stable the loops are: margins, gain limits, damping, pictures.

    Drives are identified through their FMUs; the rest is linearised at rest,
    in free air and pressing, and sampled as the co-simulation samples it.
    The gain limits are then tried in the co-simulation, which decides.
    Exit code: 0 stable at every operating point, 1 unstable at one, 2 input
    refused or no linear model, 3 a drive failed, crashed or hung.

    Example: twin analyse experiments/fig4_force_position.toml
    """
    folder = made_folder(out or Path("results/analysis") / experiment.stem)
    arguments: dict[str, Any] = {
        "experiment": str(experiment),
        "drive": drive,
        "body": body,
        "settings": settings or [],
        "tried": tried,
        "out": str(folder),
    }
    facts, text = finished(analysed, arguments, isolate)
    print(json_text(facts) if as_json else "\n".join([text, "", *(f"  {file}" for file in facts["files"])]))
    if not facts["stable"]:
        raise SystemExit(1)


def analysed(
    voice: Any, experiment: str, drive: str | None, body: str | None, settings: list[str], tried: bool, out: str
) -> tuple[dict[str, Any], str]:
    """(facts for JSON, text) of the loops, and the files of `out`; a job of the guard."""
    from twin.runs.assembly.load import load_experiment
    from twin.studies.analyse.map import draw_stability_maps
    from twin.studies.analyse.picture import draw_analysis
    from twin.studies.analyse.stability import stability
    from twin.studies.analyse.text import analysis_text

    done = stability(load_experiment(Path(experiment), settings, drive, body), tried)
    folder = Path(out)
    draw_analysis(done, folder / PICTURE)
    if done.maps:
        draw_stability_maps(done, folder / MAP)
    files = [str(folder / name) for name in (PICTURE, *([MAP] if done.maps else []), FACTS)]
    facts = done.facts() | {"files": files}
    write_json(folder / FACTS, facts)
    return facts, analysis_text(done)
