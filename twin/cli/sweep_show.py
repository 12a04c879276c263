"""`twin sweep show`: what a sweep came to."""

import os
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.cli.options import AsJson, Columns, Formats
from twin.writing import json_text

if TYPE_CHECKING:
    from twin.studies.sweep.folder import KeptRows

By = Annotated[
    str | None,
    typer.Option("--by", metavar="METRIC", help="Metric to rank by; without it, the force error."),
]


def show(
    sweep: Annotated[Path, typer.Argument(metavar="SWEEP", help="A sweep's folder, or its file (TOML).")],
    by: By = None,
    against: Annotated[
        str, typer.Option(metavar="METRIC", help="The other metric of the Pareto front.")
    ] = "lateral_error_mm",
    top: Annotated[int, typer.Option(min=1, metavar="N", help="So many of the best runs.")] = 5,
    worst: Annotated[
        str | None,
        typer.Option("--worst-over", metavar="KEY", help="Judge each choice of the others by its worst run over KEY."),
    ] = None,
    x: Annotated[str | None, typer.Option("--x", metavar="KEY", help="Parameter across the heat map.")] = None,
    y: Annotated[str | None, typer.Option("--y", metavar="KEY", help="Parameter up the heat map.")] = None,
    html: Annotated[bool, typer.Option("--html", help="Write all of it as one page, sweep.html, too.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write the rows as rows.parquet, too.")] = False,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Show what a sweep came to, also while it runs: best runs, what matters, claims.

    Text, and pictures in the sweep's folder: a heat map (map.png) if two numbers
    vary, bands of curves (bands.png) if the sweep judges claims.
    Exit code: 0 shown, 2 input refused.

    Example: twin sweep show experiments/sweeps/stiffness_and_gain.toml
    """
    from twin.experiment.drive_files import sweep_file
    from twin.studies.sweep.folder import HOME, kept

    # a sweep by its file or its name; else its folder
    if not sweep.is_dir() and os.path.isfile(file := sweep_file(sweep)):
        sweep = file
    folder = HOME / sweep.stem if sweep.suffix == ".toml" and sweep.is_file() else sweep
    if folder is not sweep and not folder.exists():
        print(f"{sweep.stem}  not begun; run it with: {shlex.join(['twin', 'sweep', str(sweep)])}")
        return
    found = kept(folder)
    # only for what is there: what reckons takes a second to load
    from twin.studies.sweep.folder import write_parquet
    from twin.studies.sweep.show.parts import Asked, axes_of, parts, sweep_text, worst_label
    from twin.studies.sweep.statistics.ranking import checked_rank, claims_in, usual_metric

    claims = claims_in(found.columns)
    metric = checked_rank("--by", by, found.metrics, claims) if by else usual_metric(found.columns)
    asked = Asked(metric, checked_rank("--against", against, found.metrics, claims), top, worst_label(found, worst))
    # a misspelt one is told before anything else
    axes_of(found, x, y)
    if not as_json:
        # pictures of a million runs take as long again
        print(sweep_text(found, asked), flush=True)
    from twin.studies.paper_figure import for_paper
    from twin.studies.sweep.show.pictures import write_pictures

    with for_paper(formats or (), columns) as paper:
        files = write_pictures(found, asked, x, y, folder)
    vectors = {f"{path.suffix[1:]} {path.stem}": path for path in paper.written}
    if html:
        from twin.report.page.sweep import write_sweep_page

        files["page"] = write_sweep_page(found, asked, files, folder)
    if parquet:
        files["rows"] = folder / "rows.parquet"
        write_parquet(found, files["rows"])
    files |= vectors
    if as_json:
        tables = [asdict(part) for part in parts(found, asked)]
        paths = {name: str(path) for name, path in files.items()}
        print(json_text(as_facts(found) | {"tables": tables, "files": paths}))
        return
    if files:
        print()
    width = max(map(len, files), default=0)
    for name, path in files.items():
        print(f"  {name:<{width}}  {path}")


def as_facts(found: "KeptRows") -> dict[str, Any]:
    """For JSON: rows without their curves, which no one reads there."""
    rows = [{key: value for key, value in row.items() if key != "curves"} for row in found.rows]
    return {"sweep": found.name, "runs": found.runs, "limits": found.limits, "rows": rows}
