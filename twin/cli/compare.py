"""`twin compare`: recordings beside the paper's claims."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.recording.recording import Recording

FIG5_EXPERIMENTS = ("pressing", "tapping", "rolling", "pushing")


class Verdict(NamedTuple):
    """What a figure's claims come to: for people, for programs, as a picture."""

    text: str
    facts: dict[str, object]
    failed: list[str]
    notes: list[str]
    draw: Callable[[Path], None]


def compare(
    paper: Annotated[str, typer.Option(metavar="FIGURE", help="Figure of the paper to score: fig4 or fig5.")],
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RUN...]",
            help="fig4: the run with force control, then the one without. fig5: any runs of tasks; without RUN, the "
            "latest of results/pressing, tapping, rolling and pushing.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where picture and JSON go; without it, results/FIGURE.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of the scorecard.")] = False,
) -> None:
    """Score runs against the claims of a figure of the paper, and draw the figure.

    A run is its folder, its .mcap file, or results/EXPERIMENT for the latest one.
    Exit code: 0 no claim fails, 1 one does, 2 input refused.

    Example: twin compare --paper fig4 results/fig4_force_position results/fig4_position
    """
    if paper not in FIGURES:
        raise InputRefused(f"--paper {paper}: expected one of {', '.join(FIGURES)}")
    verdict = FIGURES[paper](runs or [])
    folder = out or Path("results") / paper
    picture, facts = folder / f"{paper}.png", folder / f"{paper}.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        verdict.draw(picture)
        facts.write_text(json.dumps(verdict.facts, indent=2) + "\n")
    except OSError as problem:
        raise InputRefused(f"{folder}: cannot be written: {problem.strerror}") from None
    if as_json:
        print(json.dumps(verdict.facts))
    else:
        print(verdict.text)
        print(
            "\n".join([f"  note     {note}" for note in verdict.notes] + [f"  picture  {picture}\n  verdict  {facts}"])
        )
    if verdict.failed:
        raise SystemExit(1)


def _fig4(paths: list[Path]) -> Verdict:
    if len(paths) != 2:
        raise InputRefused(
            f"--paper fig4: got {len(paths)} runs, expected two: the run with force control, then the one without"
        )
    from twin.paper.fig4_runs import fig4_runs
    from twin.paper.score import fig4_score
    from twin.report.fig4 import draw_fig4
    from twin.report.scorecard import fig4_text

    recordings = _recordings(paths)
    runs = fig4_runs(*recordings)
    score = fig4_score(runs)
    notes = [recording.note for recording in recordings if recording.note]
    return Verdict(fig4_text(score), score.facts(), score.failed, notes, lambda path: draw_fig4(runs, path))


def _fig5(paths: list[Path]) -> Verdict:
    from twin.paper.fig5_score import fig5_score
    from twin.report.fig5 import draw_fig5
    from twin.report.scorecard import fig5_text

    score = fig5_score(_recordings(paths or _latest_of_each_task()))
    return Verdict(fig5_text(score), score.facts(), score.failed, [], lambda path: draw_fig5(score, path))


def _latest_of_each_task() -> list[Path]:
    paths = [Path("results") / name for name in FIG5_EXPERIMENTS]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        files = " ".join(f"experiments/{name}.toml" for name in missing)
        raise InputRefused(f"--paper fig5: no run of {', '.join(missing)} in results/; first: twin run {files}")
    return paths


def _recordings(paths: list[Path]) -> "list[Recording]":
    from twin.recording.folder import recording_in
    from twin.recording.reader import read

    return [read(recording_in(path)) for path in paths]


FIGURES = {"fig4": _fig4, "fig5": _fig5}
