"""`twin compare`: two logs within a tolerance tube, or recordings beside the paper's claims."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from twin.cli.options import AsJson
from twin.errors import InputRefused, visible_lines
from twin.writing import json_text, made_folder, write_json

if TYPE_CHECKING:
    from twin.recording.recording import Recording

FIG4_EXPERIMENTS = ("fig4_force_position", "fig4_position", "fig4_imperfect", "fig4_imperfect_position")
FIG5_EXPERIMENTS = ("pressing", "tapping", "rolling", "pushing")


class Verdict(NamedTuple):
    """What a comparison comes to: for people, for programs, as a picture."""

    text: str
    facts: dict[str, object]
    failed: list[str]
    notes: list[str]
    draw: Callable[[Path], None]


def compare(
    runs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="A B",
            help="A recording (its folder, its .mcap file, results/EXPERIMENT), another MCAP file or a CSV file. With "
            "--paper: fig4: the run with force control, then the one without, then the same two of the imperfect robot "
            "for the forces in x; fig5: any runs of tasks; none: the latest of the figure's experiments in results/.",
        ),
    ] = None,
    paper: Annotated[
        str | None, typer.Option(metavar="FIGURE", help="Score runs against the paper: fig4 or fig5.")
    ] = None,
    signal: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Compare only these; * and ? fit any.")
    ] = None,
    tol: Annotated[
        list[str] | None,
        typer.Option(metavar="RULE", help="2%@4ms (the default), NAME=0.05N, NAME=0.1mm@10ms, FILE.toml."),
    ] = None,
    column_map: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="MAP", help="Column of a foreign file: NAME=[-]COLUMN[UNIT], FILE.toml."),
    ] = None,
    align: Annotated[str, typer.Option(metavar="HOW", help="Time of B: none, start, event or fit.")] = "none",
    by: Annotated[str, typer.Option(metavar="NAME", help="Signal to align by, for event and fit.")] = "",
    max_shift: Annotated[float, typer.Option(metavar="S", help="Largest shift of fit, in s.")] = 1.0,
    partial: Annotated[
        bool, typer.Option("--partial", help="Let B cover only a part of A's time; what it covers is compared.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where picture and JSON go; results/compare, or results/FIGURE."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare B with A within a tolerance tube, or runs with a figure of the paper.

    B is right where it is, at some instant no more than the tolerance in time
    away, no farther from A than the tolerance in value. docs/compare.md tells
    of columns, units, tolerances, alignment and digitised figures.

    Exit code: 0 inside, or no claim fails; 1 outside, or B lacks a part of A's
    time (without --partial), or a claim fails; 2 refused; 3 not written.

    Example: twin compare --paper fig4 results/fig4_force_position results/fig4_position
    """
    if paper is None:
        name = "compare"
        verdict = _tube(runs or [], signal or [], tol or [], column_map or [], (align, by, max_shift), partial)
    elif paper not in FIGURES:
        raise InputRefused(f"--paper {paper}: expected one of {', '.join(FIGURES)}")
    elif signal or tol or column_map or partial or align != "none":
        raise InputRefused(f"--paper {paper}: takes no --signal, --tol, --map, --align, --partial; claims have bounds")
    else:
        name, verdict = paper, FIGURES[paper](runs or [])
    folder = out or Path("results") / name
    picture, facts = folder / f"{name}.png", folder / f"{name}.json"
    made_folder(folder)
    verdict.draw(picture)
    write_json(facts, verdict.facts)
    if as_json:
        print(json_text(verdict.facts))
    else:
        notes = [f"  note     {note}" for note in verdict.notes]
        # names in a recording are anybody's
        print(visible_lines("\n".join([verdict.text, *notes, f"  picture  {picture}\n  verdict  {facts}"])))
    if verdict.failed:
        raise SystemExit(1)


def _tube(
    paths: list[Path],
    signals: list[str],
    tolerances: list[str],
    maps: list[str],
    align: tuple[str, str, float],
    partial: bool,
) -> Verdict:
    if len(paths) != 2:
        raise InputRefused(
            f"twin compare: got {len(paths)} path{'s' * (len(paths) != 1)}, expected A and B, or --paper FIGURE"
        )
    from twin.studies.compare.alignment import alignment
    from twin.studies.compare.comparison import compared
    from twin.studies.compare.inputs import both
    from twin.studies.compare.picture import draw_comparison
    from twin.studies.compare.text import comparison_text
    from twin.studies.compare.tolerance import rules

    found = compared(*both(paths[0], paths[1], maps), rules(tolerances), signals, alignment(*align))
    failed = [row.signal for row in found.outside]
    lacking, share = found.least_covered
    if share < 1.0 and not partial:
        failed.append(lacking)
    text = comparison_text(found, partial)
    return Verdict(text, found.facts(), failed, [], lambda path: draw_comparison(found, path))


def _fig4(paths: list[Path]) -> Verdict:
    paths = paths or _latest("fig4", FIG4_EXPERIMENTS)
    if len(paths) not in (2, 4):
        raise InputRefused(
            f"--paper fig4: got {len(paths)} run{'s' * (len(paths) != 1)}, expected two: the run with force control, "
            f"then the one without; or four: {', '.join(FIG4_EXPERIMENTS)}"
        )
    from twin.studies.paper.fig4_picture import draw_fig4
    from twin.studies.paper.fig4_runs import fig4_runs
    from twin.studies.paper.score import fig4_score
    from twin.studies.paper.text import fig4_text

    recordings = _recordings(paths)
    runs = fig4_runs(*recordings)
    score = fig4_score(runs)
    notes = [*(recording.note for recording in recordings if recording.note), *_notes(recordings)]
    return Verdict(fig4_text(score), score.facts(), score.failed, notes, lambda path: draw_fig4(runs, path))


def _fig5(paths: list[Path]) -> Verdict:
    from twin.studies.paper.fig5_picture import draw_fig5
    from twin.studies.paper.fig5_score import fig5_score
    from twin.studies.paper.text import fig5_text

    recordings = _recordings(paths or _latest("fig5", FIG5_EXPERIMENTS))
    score = fig5_score(recordings)
    notes = _notes(recordings)
    return Verdict(fig5_text(score), score.facts(), score.failed, notes, lambda path: draw_fig5(score, path))


def _notes(recordings: "list[Recording]") -> list[str]:
    return [f"{recording.path}: {text}" for recording in recordings for text in recording.deviations]


def _latest(figure: str, experiments: Sequence[str]) -> list[Path]:
    paths = [Path("results") / name for name in experiments]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        files = " ".join(f"experiments/{name}.toml" for name in missing)
        raise InputRefused(f"--paper {figure}: no run of {', '.join(missing)} in results/; first: twin run {files}")
    return paths


def _recordings(paths: list[Path]) -> "list[Recording]":
    from twin.recording.folder import recording_in
    from twin.recording.reader import read

    return [read(recording_in(path)) for path in paths]


FIGURES = {"fig4": _fig4, "fig5": _fig5}
