"""`twin drive survey`: try every FMU below a folder, and keep what came out as data and as a page."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.options import AsJson


def survey(
    place: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="With FMUs, at any depth; or the .json of an earlier survey.")
    ],
    sources: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML: for each folder in FOLDER a table, from = where it is from."),
    ] = None,
    data: Annotated[Path, typer.Option(metavar="FILE", help="What came out, as JSON.")] = Path(
        "results/drive_survey/survey.json"
    ),
    page: Annotated[Path | None, typer.Option(metavar="FILE", help="The same as a page of Markdown.")] = None,
    wall: Annotated[float, typer.Option("--limit-wall", metavar="S", min=1.0, help="Longest time of one FMU.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Try every FMU below a folder, each in a process of its own: what it is, what was tried, what came out.

    An FMU that crashes, hangs or grows costs itself only.

    Exit code: 0 done whatever came out, 2 no such folder or no FMU in it, 3 not
    written.

    Example: twin drive survey fmus
    """
    asked = {"place": place, "sources": sources, "data": data, "page": page, "wall": wall}
    ask("twin.studies.survey.study:survey", asked, as_json)
