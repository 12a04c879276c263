"""`twin analyse`: the loops of an experiment, linear."""

import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.errors import ComponentFailed, InputRefused

FACTS, PICTURE, MAP = "analysis.json", "analysis.png", "map.png"


def analyse(
    experiment: Annotated[Path, typer.Argument(metavar="EXPERIMENT", help="Experiment file (TOML).")],
    drive: Annotated[
        str | None, typer.Option(metavar="FMU", help="Drive of every joint: an .fmu file, or a drive of fmus/.")
    ] = None,
    body: Annotated[
        str | None, typer.Option(metavar="BODY", help="What to press on: a file of experiments/bodies/.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the experiment.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where pictures and JSON go: results/analysis/EXPERIMENT.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
    isolate: Annotated[bool, typer.Option(help="Run the drives in a process of their own.")] = os.name == "posix",
) -> None:
    """Tell how stable the loops are: margins, gain limits, damping, pictures.

    Drives are identified through their FMUs; the rest is linearised at rest,
    in free air and pressing, and sampled as the co-simulation samples it.
    Exit code: 0 stable at every operating point, 1 unstable at one, 2 input
    refused or no linear model, 3 a drive failed, crashed or hung.

    Example: twin analyse experiments/fig4_force_position.toml
    """
    folder = out or Path("results/analysis") / experiment.stem
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputRefused(f"{folder}: cannot be made: {problem.strerror}") from None
    arguments: dict[str, Any] = {
        "experiment": str(experiment),
        "drive": drive,
        "body": body,
        "settings": settings or [],
        "out": str(folder),
    }
    facts, text = _guarded(arguments) if isolate else analysed(None, **arguments)
    print(json.dumps(facts) if as_json else "\n".join([text, "", *(f"  {file}" for file in facts["files"])]))
    if not facts["stable"]:
        raise SystemExit(1)


def _guarded(arguments: dict[str, Any]) -> Any:
    """As `analysed`, in a process of its own.

    Raises:
        ComponentFailed: an FMU crashed, hung or ended that process.
    """
    from twin.guard.guard import JobDiedLoading, guarded

    try:
        return guarded("twin.cli.analyse:analysed", arguments)
    except JobDiedLoading as death:
        raise ComponentFailed(str(death)) from None


def analysed(
    voice: Any, experiment: str, drive: str | None, body: str | None, settings: list[str], out: str
) -> tuple[dict[str, Any], str]:
    """(facts for JSON, text) of the loops, and the files of `out`; a job of the guard."""
    from twin.experiment.experiment import load_experiment
    from twin.loop_analysis.stability import stability
    from twin.report.analysis import draw_analysis
    from twin.report.analysis_map import draw_stability_maps
    from twin.report.analysis_text import analysis_text

    done = stability(load_experiment(Path(experiment), settings, drive, body))
    folder = Path(out)
    try:
        draw_analysis(done, folder / PICTURE)
        if done.maps:
            draw_stability_maps(done, folder / MAP)
        files = [str(folder / name) for name in (PICTURE, *([MAP] if done.maps else []), FACTS)]
        facts = done.facts() | {"files": files}
        (folder / FACTS).write_text(json.dumps(facts, indent=2) + "\n")
    except OSError as problem:
        raise InputRefused(f"{folder}: cannot be written: {problem.strerror}") from None
    return facts, analysis_text(done)
