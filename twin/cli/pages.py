"""Commands that write HTML pages: of runs, of drives side by side, of a sweep."""

import math
import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from twin.kernel.process.job import JobLimits
from twin.studies.command import (
    JOB_ISOLATION,
    Answer,
    Argument,
    AsJson,
    BodyName,
    Columns,
    Formats,
    Isolate,
    LimitStep,
    LimitWall,
    Option,
    Say,
    Settings,
    answer_apart,
    study,
)
from twin.studies.first_look import load_experiments, print_latest
from twin.studies.sweep.study import By


@study(isolated="budget", before=[print_latest])
def report(
    runs: Annotated[
        Sequence[Path],
        Argument("A run's folder, its .mcap file, or results/EXPERIMENT for the latest.", "RUN"),
    ],
    say: Say,
    out: Annotated[
        Path | None, Option("The page; default: report.html beside the run, or results/report for several.", "FILE")
    ] = None,
    budget: Annotated[bool, Option("Also run without imperfections: the budget of the force error.")] = False,
) -> Answer:
    """Write a run, or several side by side, as one offline HTML page.

    Exit code: 0 written, whatever the verdict, 2 input refused, 3 a component
    failed while a budget was made.

    Example: twin report results/fig4_force_position results/fig4_position

    Raises:
        TwinError: see `write_report`.
    """
    from twin.report.page.page import write_report

    return write_report(runs, out, budget, say)


@study("drive compare", before=[load_experiments])
def drive_compare(
    drives: Annotated[
        Sequence[str], Argument("Drives: .fmu files, folders, or names in fmus/.", "FMU", complete="drive")
    ],
    experiments: Annotated[
        Sequence[Path],
        Option("An experiment, file or name; may be repeated.", "FILE", "--experiment", complete="experiment"),
    ],
    say: Say,
    body: BodyName = None,
    settings: Settings = (),
    out: Annotated[Path, Option("Folder of the pictures.", "DIR")] = Path("results/drive_compare"),
    html: Annotated[bool, Option("Also write one page, compare.html.")] = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    formats: Formats = (),
    columns: Columns = 2,
) -> Answer:
    """Run the same experiments with each drive, and compare the true signals.

    The answer says where each drive is better or worse than the first; the
    numbers follow. Exit code: 0 all ran, 2 one is refused (none has run), 3
    one failed.

    Example: twin drive compare velocity_servo pmsm_foc --experiment experiments/pressing.toml

    Raises:
        InputRefused, ComponentFailed, NotWritten: see `compare_drives`.
    """
    name, limits = "twin.studies.qualify.study:compare_drives", JobLimits(limit_step, limit_wall)
    asked = {"fmus": drives, "experiments": experiments, "settings": settings, "body": body, "out": out}
    answer = answer_apart(name, asked, say, isolate, limits, formats, columns)
    if not html:
        return answer
    from twin.report.page.drives import write_drives_page

    page = write_drives_page(answer.facts, out)
    return replace(answer, text=f"{answer.text}\npage     {page}", facts=answer.facts | {"page": str(page)})


@study("sweep show")
def sweep_show(
    sweep: Annotated[Path, Argument("A sweep's folder, or its file (TOML).", "SWEEP")],
    say: Say,
    by: By = None,
    against: Annotated[str, Option("The other metric of the Pareto front.", "METRIC")] = "lateral_error_mm",
    top: Annotated[int, Option("Number of best runs to show.", "N", least=1)] = 5,
    worst: Annotated[str | None, Option("Rank by the worst run over KEY.", "KEY", "--worst-over")] = None,
    x: Annotated[str | None, Option("Parameter on the x axis of the heat map.", "KEY", "--x")] = None,
    y: Annotated[str | None, Option("Parameter on the y axis of the heat map.", "KEY", "--y")] = None,
    html: Annotated[bool, Option("Also write one page, sweep.html.")] = False,
    parquet: Annotated[bool, Option("Also write the rows as rows.parquet.")] = False,
    formats: Formats = (),
    columns: Columns = 2,
    as_json: AsJson = False,
) -> Iterator[Answer]:
    """Show the results of a sweep, also while it runs: best runs, sensitivities, claims.

    Text, and pictures in the sweep's folder: a heat map (map.png) if two
    numbers vary, bands of curves (bands.png) if the sweep judges claims.

    Exit code: 0 shown, 2 input refused.

    Example: twin sweep show experiments/sweeps/stiffness_and_gain.toml

    Raises:
        InputRefused: there is no such sweep, metric or parameter.
        NotWritten: the disk refuses.
    """
    from twin.robot.experiment.drive_files import sweep_file
    from twin.studies.sweep.rows import HOME, stored_sweep

    # a sweep by its file or its name; else its folder
    if not sweep.is_dir() and os.path.isfile(file := sweep_file(sweep)):
        sweep = file
    folder = HOME / sweep.stem if sweep.suffix == ".toml" and sweep.is_file() else sweep
    if folder is not sweep and not folder.exists():
        print(f"{sweep.stem}  not begun; run it with: {shlex.join(['twin', 'sweep', str(sweep)])}")
        return
    found = stored_sweep(folder)
    # only for what is there: what reckons takes a second to load
    from twin.studies.figure import for_paper
    from twin.studies.sweep.rows import write_parquet
    from twin.studies.sweep.show.parts import Asked, axes_of, parts, sweep_text, worst_label
    from twin.studies.sweep.show.pictures import write_pictures
    from twin.studies.sweep.statistics.ranking import checked_rank, claims_in, usual_metric
    from twin.studies.sweep.study import rows_facts

    claims = claims_in(found.columns)
    metric = checked_rank("--by", by, found.metrics, claims) if by else usual_metric(found.columns)
    asked = Asked(metric, checked_rank("--against", against, found.metrics, claims), top, worst_label(found, worst))
    # a misspelt one is reported before anything else
    axes_of(found, x, y)
    if not as_json:
        # pictures of a million runs take as long again
        yield Answer(sweep_text(found, asked), {})
    with for_paper(formats, columns) as paper:
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
        yield Answer("", rows_facts(found) | {"tables": tables, "files": paths})
    elif files:
        width = max(map(len, files))
        yield Answer("\n".join(["", *(f"  {name:<{width}}  {path}" for name, path in files.items())]), {})
