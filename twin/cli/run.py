"""Commands of runs: `twin run`, experiments in and recordings out; and the HTML pages of runs, drives and sweeps."""

import math
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

from twin.cli.ahead import RUN_JOB
from twin.cli.ask import NoteListener, run_recording_job
from twin.cli.streams import print_answer
from twin.cli.terminal import TerminalDisplay
from twin.kernel.errors import InputRefused, terminal_text
from twin.kernel.process.guard import STOP_TIMEOUT
from twin.kernel.process.job import LONG_RUN_DURATION, JobLimits
from twin.studies.command import (
    DEFAULT_PORT,
    JOB_ISOLATION,
    Answer,
    Argument,
    AsJson,
    BodyName,
    Columns,
    DriveName,
    Formats,
    Isolate,
    Isolation,
    LimitStep,
    LimitWall,
    LiveOrigins,
    LivePort,
    Option,
    Page,
    Say,
    Settings,
    run_isolated,
    study,
)
from twin.studies.precheck import load_experiments, print_latest
from twin.studies.sweep.study import By, rows_to_dict

LIVE_JOB = "twin.robot.live.runs:served_runs"
DEFAULT_MEMORY_LIMIT = 4000.0


@study(json=False)
def run(
    experiments: Annotated[
        Sequence[Path], Argument("Experiment files (TOML), or names.", "EXPERIMENT", complete="experiment")
    ] = (),
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    ranges: Annotated[
        Sequence[str],
        Option("Run once per value, like twin sweep; writes rows, no recordings.", "KEY=FROM:TO:COUNT", "--sweep"),
    ] = (),
    start_from: Annotated[
        str | None, Option("Continue from a state of a run; with --set, only duration_s.", "RUN[@SECONDS]", "--from")
    ] = None,
    out: Annotated[Path | None, Option("Folder of the run; default: results/EXPERIMENT/TIME.", "DIR")] = None,
    as_json: Annotated[bool, Option("Print one JSON object per run instead of text.", flags="--json")] = False,
    report: Page = False,
    isolate: Annotated[
        Isolation,
        Option("Processes: one for the run, one more per drive, or none (for debuggers)."),
    ] = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    limit_memory: Annotated[float, Option("Most memory of the run's process.", "MB", least=0.0)] = DEFAULT_MEMORY_LIMIT,
    live: Annotated[bool, Option("Serve the run to Lichtblick or Foxglove; starts with the first viewer.")] = False,
    port: LivePort = DEFAULT_PORT,
    origins: LiveOrigins = (),
    realtime: Annotated[
        float | None,
        Option("Speed as a multiple of real time; 0: as fast as possible; with --live: 1.", "[=FACTOR]", least=0.0),
    ] = None,
    yes: Annotated[bool, Option("Allow runs of more than an hour or 5 GB.")] = False,
) -> None:
    """Run experiments and record them.

    Exit code: 0 done, 3 a component failed while running (error, crash, hang),
    2 input refused (also an FMU that crashes before the first step), 4 the
    safety monitor tripped although the experiment has no faults, 130
    interrupted, 143 terminated.

    Example: twin run experiments/fig4_force_position.toml --drive pmsm_foc --out results/pmsm_foc
    """
    if ranges:
        others = (body, report, live, realtime is not None, isolate != "run", limit_wall < math.inf)
        if len(experiments) > 1 or any(others) or limit_memory != DEFAULT_MEMORY_LIMIT:
            raise InputRefused(
                "--sweep: takes one experiment and --drive, --set, --out, --limit-step, --json; "
                "for more, write a sweep file for twin sweep"
            )
        from twin.studies.sweep.study import short_sweep

        with TerminalDisplay(loading=False) as display:
            answer = short_sweep(experiments[0], ranges, drive, settings, out, limit_step, as_json, yes, display.say)
        print_answer(answer, as_json)
        raise SystemExit(answer.exit_code)
    if not experiments and start_from is None:
        raise InputRefused("twin run: missing argument 'EXPERIMENT'; see twin run --help")
    if start_from is not None and (experiments or drive is not None or body is not None):
        raise InputRefused(
            "--from: the run determines its experiment, drive and body; leave them out, or use twin branch"
        )
    if out is not None and len(experiments) > 1:
        raise InputRefused(f"--out {out}: names the folder of one run; {len(experiments)} experiments were given")
    require_isolation(isolate)
    if realtime is not None and not math.isfinite(realtime):
        raise InputRefused(f"--realtime={realtime}: expected a finite factor; 0 runs as fast as it goes")
    factor = realtime if realtime is not None or not live else 1.0
    arguments: dict[str, Any] = {
        "experiments": [str(path) for path in experiments],
        "settings": settings,
        "drive": drive,
        "body": body,
        "out": str(out) if out else None,
        "isolate_drives": isolate == "drive",
        "limit_step": limit_step,
        "factor": factor,
        "sure": yes,
        "start_from": start_from,
        **({"port": port, "origins": origins} if live else {}),
    }
    # no expected-duration limit: a paced run lasts as long as requested
    longest = math.inf if yes or factor else LONG_RUN_DURATION
    limits = JobLimits(step_limit(limit_step, isolate), limit_wall, 1e6 * limit_memory, longest)
    with RunPageWriter(report, as_json) as reported, TerminalDisplay(as_json) as display:
        run_recording_job(
            LIVE_JOB if live else RUN_JOB,
            arguments,
            display,
            isolate,
            limits,
            reported.collect_folders(display.on_note),
        )


def require_isolation(isolate: Isolation) -> None:
    """Refuse processes of a run where the system cannot guard them."""
    if isolate != "none" and os.name != "posix":
        raise InputRefused(f"--isolate {isolate}: needs Linux or macOS; use --isolate none here")


def step_limit(limit_step: float, isolate: Isolation) -> float:
    """Return the timeout (s) of a step for the process of a run, given that of a call into a drive."""
    # the run itself detects a hanging drive in another process, and finishes more cleanly than if it is ended
    return limit_step + (STOP_TIMEOUT if isolate == "drive" else 0.0)


class RunPageWriter:
    """Writer of one report page about all runs of a command when they are over, even if one of them failed.

    With `one_object`, the only run is reported after that, so that its JSON object has the path of the page.
    """

    def __init__(self, wanted: bool, as_json: bool, one_object: bool = False):
        self._wanted, self._as_json, self._waits = wanted, as_json, wanted and as_json and one_object
        self._folders: list[Path] = []
        self._report_run: Callable[[Mapping[str, Any]], None] | None = None

    def collect_folders(self, listener: NoteListener) -> NoteListener:
        """Wrap a listener to job notes so that it also collects the folders of the runs."""

        def on_note(note: dict[str, Any]) -> None:
            if "folder" in note:
                self._folders.append(Path(note["folder"]))
            if self._waits and "run" in note:
                self._report_run = lambda page: listener({"run": {**note["run"], **page}})
            else:
                listener(note)

        return on_note

    def __enter__(self) -> "RunPageWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *failure: object) -> None:
        recorded = [folder for folder in self._folders if any(folder.glob("*.mcap*"))]
        if not self._wanted or not recorded:
            return
        from twin.report.page.page import write_report

        page: Mapping[str, Any] = {}
        try:
            answer = write_report(recorded)
            page = answer.facts
            if self._report_run is None:
                print_answer(answer, self._as_json)
        except InputRefused as problem:
            if kind is None:
                raise
            # the reason why the run itself ended is printed last
            print(terminal_text(str(problem)), file=sys.stderr)
        finally:
            if self._report_run is not None:
                self._report_run(page)


@study(isolated="budget", before=[print_latest])
def report(
    runs: Annotated[
        Sequence[Path],
        Argument("A run's folder, its .mcap file, or results/EXPERIMENT for the latest.", "RUN"),
    ],
    say: Say,
    out: Annotated[
        Path | None, Option("The page; default: report.html in its folder, or results/report for several.", "FILE")
    ] = None,
    budget: Annotated[bool, Option("Also run without imperfections: the budget of the force error.")] = False,
) -> Answer:
    """Write a run, or several side by side, as one offline HTML page.

    Exit code: 0 written, whatever the verdict, 2 input refused, 3 a component
    failed while a budget was made.

    Example: twin report results/fig4_force_position results/fig4_position
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

    The answer states where each drive is better or worse than the first; the
    numbers follow. Exit code: 0 all ran, 2 a drive or experiment is refused
    (nothing has run), 3 a run failed.

    Example: twin drive compare velocity_servo pmsm_foc --experiment experiments/pressing.toml
    """
    name, limits = "twin.studies.qualify.study:compare_drives", JobLimits(limit_step, limit_wall)
    asked = {"fmus": drives, "experiments": experiments, "settings": settings, "body": body, "out": out}
    answer = run_isolated(name, asked, say, isolate, limits, formats, columns)
    if not html:
        return answer
    from twin.report.page.plain import write_drives_page

    page = write_drives_page(answer.facts, out)
    return replace(answer, text=f"{answer.text}\npage     {page}", facts=answer.facts | {"page": str(page)})


@study("sweep show")
def sweep_show(
    sweep: Annotated[Path, Argument("A sweep's folder, or its file (TOML).", "SWEEP")],
    say: Say,
    by: By = None,
    against: Annotated[
        str | None, Option("The other metric of the Pareto front; without it, the settling time.", "METRIC")
    ] = None,
    top: Annotated[int, Option("Number of best runs to show.", "N", least=1)] = 5,
    worst: Annotated[str | None, Option("Rank by the worst run over KEY.", "KEY", "--worst-over")] = None,
    x: Annotated[str | None, Option("Parameter on the x axis of the heat map.", "KEY", "--x")] = None,
    y: Annotated[str | None, Option("Parameter on the y axis of the heat map.", "KEY", "--y")] = None,
    sensitivity: Annotated[bool, Option("Also print rank correlations and Sobol indices.")] = False,
    html: Annotated[bool, Option("Also write one page, sweep.html.")] = False,
    parquet: Annotated[bool, Option("Also write the rows as rows.parquet.")] = False,
    formats: Formats = (),
    columns: Columns = 2,
    as_json: AsJson = False,
) -> Iterator[Answer]:
    """Show the results of a sweep, also while it runs: best runs, claims, sensitivities.

    Text, and pictures in the sweep's folder: a heat map (map.png) if two
    numbers vary, bands of curves (bands.png) if the sweep judges claims.

    Exit code: 0 shown, 2 input refused.

    Example: twin sweep show experiments/sweeps/stiffness_and_gain.toml
    """
    from twin.robot.experiment.experiment_files import sweep_file
    from twin.studies.sweep.stored import SWEEPS_FOLDER, stored_sweep

    # a sweep file or name; else a sweep's folder
    if not sweep.is_dir() and os.path.isfile(file := sweep_file(sweep)):
        sweep = file
    folder = SWEEPS_FOLDER / sweep.stem if sweep.suffix == ".toml" and sweep.is_file() else sweep
    if folder is not sweep and not folder.exists():
        print(f"{sweep.stem}  not begun; run it with: {shlex.join(['twin', 'sweep', str(sweep)])}")
        return
    found = stored_sweep(folder)
    # imported after the check of the folder: numerical packages take a second to load
    from twin.studies.figure import for_paper
    from twin.studies.sweep.parquet import write_parquet
    from twin.studies.sweep.show.parts import SweepQuery, axes_of, parts, sweep_text, worst_label
    from twin.studies.sweep.show.pictures import write_pictures
    from twin.studies.sweep.statistics.ranking import claims_in, require_rank, usual_against, usual_metric

    claims = claims_in(found.columns)
    metric = require_rank("--by", by, found.metrics, claims) if by else usual_metric(found.columns)
    checked = require_rank("--against", against, found.metrics, claims) if against else None
    asked = SweepQuery(metric, checked or usual_against(found.columns, metric), top, worst_label(found, worst))
    # report a misspelt axis before anything else
    axes_of(found, x, y)
    if not as_json:
        # text first: pictures of a million runs take as long again
        yield Answer(sweep_text(found, asked, sensitivity), {})
    with for_paper(formats, columns) as paper:
        files = write_pictures(found, asked, x, y, folder)
    vectors = {f"{path.suffix[1:]} {path.stem}": path for path in paper.written}
    if html:
        from twin.report.page.plain import write_sweep_page

        files["page"] = write_sweep_page(found, asked, files, folder)
    if parquet:
        files["rows"] = folder / "rows.parquet"
        write_parquet(found, files["rows"])
    files |= vectors
    if as_json:
        tables = [asdict(part) for part in parts(found, asked)]
        paths = {name: str(path) for name, path in files.items()}
        yield Answer("", rows_to_dict(found) | {"tables": tables, "files": paths})
    elif files:
        width = max(map(len, files))
        yield Answer("\n".join(["", *(f"  {name:<{width}}  {path}" for name, path in files.items())]), {})
