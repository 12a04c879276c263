"""`twin check`: experiments against their baselines."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.completion import drive_names, experiment_files
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, JobIsolation
from twin.errors import InputRefused, plain
from twin.writing import json_text

PICTURES = Path("results/check")


def check(
    experiments: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[EXPERIMENT]...",
            help="Experiments that say what to measure, files or names; none: all that have baselines.",
            autocompletion=experiment_files,
        ),
    ] = None,
    drives: Annotated[
        list[str] | None,
        typer.Option(
            "--drive",
            metavar="FMU",
            help="Drive of fmus/ or .fmu file; own: the experiment's; all: those of fmus/. May be repeated. Without "
            "it, those with a baseline.",
            autocompletion=drive_names,
        ),
    ] = None,
    update: Annotated[bool, typer.Option("--update", help="Accept what is now as the baseline.")] = False,
    reason: Annotated[str, typer.Option(metavar="TEXT", help="Why; kept in the baseline.")] = "",
    baselines: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where baselines are: tests/baselines here, else those that come with twin.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where pictures of curves outside their tubes go.")
    ] = PICTURES,
    jobs: Annotated[int, typer.Option("--jobs", "-j", metavar="N", min=1, help="Processes that run experiments.")] = 2,
    isolate: Isolate = JOB_ISOLATION,
    as_json: AsJson = False,
) -> None:
    """Check experiments against what they came to before, drive by drive.

    Numbers have bounds and curves have tubes, stored in tests/baselines as
    docs/regression.md tells. --update shows the difference, then accepts it.
    Of curves outside their tubes there are pictures.

    Exit code: 0 all as it was, or updated; 1 something deviates; 2 input
    refused, or no baseline; 3 a drive failed; 4 the safety monitor tripped.

    Example: twin check experiments/step_z_air.toml --drive velocity_servo
    """
    from twin.cli.check_jobs import finished
    from twin.studies.check.baseline import FOLDER, baseline_file, baselines_here, write_baseline
    from twin.studies.check.job import pairs
    from twin.studies.check.text import check_text

    if update != bool(reason.strip()):
        raise InputRefused('twin check: --update and --reason "why the numbers may move" go together; give both')
    folder = baselines or (FOLDER if update else baselines_here())
    wanted = pairs(experiments or [], drives or [], folder)
    done = finished(wanted, folder, reason, jobs if isolate == JobIsolation.RUN else 0)
    verdicts = [outcome.verdict for outcome in done if outcome.verdict]
    failures = [outcome for outcome in done if outcome.failure]
    told = [{"experiment": Path(o.pair.file).stem, "drive": o.pair.drive, "failure": o.failure} for o in failures]
    facts = {"verdicts": [verdict.facts() for verdict in verdicts], "failures": told}
    print(json_text(facts) if as_json else check_text(verdicts, [plain(outcome.failure) for outcome in failures]))
    places = []
    moved = [outcome for outcome in done if outcome.text]
    for outcome in moved:
        write_baseline(baseline_file(folder, Path(outcome.pair.file).stem, outcome.pair.drive), outcome.text)
    if update and verdicts:
        places.append(f"  written  {len(moved)} of {len(verdicts)} baselines in {folder}")
    if any(verdict.outside for verdict in verdicts):
        from twin.studies.check.picture import check_pictures

        places += [f"  picture  {picture}" for picture in check_pictures(verdicts, out)]
    if places and not as_json:
        print("\n" + "\n".join(places))
    if failures:
        raise SystemExit(failures[0].exit_code)
    if not update and any(verdict.deviations for verdict in verdicts):
        raise SystemExit(1)
