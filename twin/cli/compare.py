"""`twin compare`: two logs within a tolerance tube, or recordings beside the paper's claims."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.first_look import look_at_logs
from twin.cli.latest import tell_latest
from twin.cli.options import AsJson, Columns, Formats
from twin.errors import InputRefused

FIGURES = {"fig4": "twin.studies.paper.study:score_fig4", "fig5": "twin.studies.paper.study:score_fig5"}


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
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Compare B with A within a tolerance tube, or runs with a figure of the paper.

    B is right where it is, at some instant no more than the tolerance in time
    away, no farther from A than the tolerance in value. docs/compare.md
    tells how, docs/compare_reference.md of columns, units, tolerances, alignment.

    Exit code: 0 inside, or no claim fails; 1 outside, or B lacks a part of A's
    time (without --partial), or a claim fails or cannot be scored; 2 refused;
    3 not written.

    Example: twin compare --paper fig4 results/fig4_force_position results/fig4_position
    """
    look_at_logs(runs or [])
    tell_latest(runs or ([] if paper is None else _latest(paper)))
    if paper is None:
        asked = {
            "paths": runs or [],
            "signals": signal or [],
            "tolerances": tol or [],
            "maps": column_map or [],
            "align": (align, by, max_shift),
            "partial": partial,
            "out": out,
        }
        ask("twin.studies.compare.study:compare", asked, as_json, formats=formats, columns=columns)
    elif paper not in FIGURES:
        raise InputRefused(f"--paper {paper}: expected one of {', '.join(FIGURES)}")
    elif signal or tol or column_map or partial or align != "none":
        raise InputRefused(f"--paper {paper}: takes no --signal, --tol, --map, --align, --partial; claims have bounds")
    else:
        ask(FIGURES[paper], {"paths": runs or [], "out": out}, as_json, formats=formats, columns=columns)


def _latest(figure: str) -> list[Path]:
    """Where the runs of a figure are looked for if none are named."""
    from twin.studies.paper.study import FIGURE_EXPERIMENTS, HOME

    return [HOME / name for name in FIGURE_EXPERIMENTS.get(figure, ())]
