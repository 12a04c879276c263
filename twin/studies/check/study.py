"""`twin check`: regression checks of experiments against their baselines."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from twin.kernel.errors import InputRefused, terminal_text
from twin.kernel.serialise import to_dict
from twin.studies.command import JOB_ISOLATION, Argument, Isolate, Option, Say, study
from twin.studies.precheck import find_experiments
from twin.studies.result import Result

PICTURE_FOLDER = Path("results/check")


@study(before=[find_experiments])
def check(
    say: Say,
    experiments: Annotated[
        Sequence[Path],
        Argument(
            "Experiments with [[measure]] tables, files or names; default: all with baselines.",
            "EXPERIMENT",
            complete="experiment",
        ),
    ] = (),
    drives: Annotated[
        Sequence[str],
        Option(
            "Drive of fmus/ or .fmu file; own: the experiment's; all: those of fmus/. May be repeated. Without "
            "it, those with a baseline.",
            "FMU",
            "--drive",
            complete="drive",
        ),
    ] = (),
    update: Annotated[bool, Option("Accept today's values as the baseline.")] = False,
    reason: Annotated[str, Option("Reason, stored in the baseline.", "TEXT")] = "",
    baselines: Annotated[
        Path | None,
        Option(
            "Folder of baselines; default: tests/baselines here, else twin's; in a clone of twin, "
            "baselines/ next to an experiment of your own.",
            "DIR",
        ),
    ] = None,
    out: Annotated[Path, Option("Folder for pictures of curves outside their tubes.", "DIR")] = PICTURE_FOLDER,
    jobs: Annotated[int, Option("Number of parallel processes.", "N", "--jobs -j", least=1)] = 2,
    isolate: Isolate = JOB_ISOLATION,
) -> Result:
    """Check experiments against their stored baselines, drive by drive.

    Numbers have bounds and curves have tubes, stored in tests/baselines
    (docs/regression.md). --update shows the differences and accepts them.
    Curves outside their tubes are drawn.

    Exit code: 0 all as it was, or updated; 1 something deviates; 2 input
    refused, or no baseline; 3 a drive failed; 4 the safety monitor tripped.

    Example: twin check experiments/step_z_air.toml --drive velocity_servo
    """
    from twin.studies.check.baseline import baseline_file, write_baseline
    from twin.studies.check.job import outcomes, pairs
    from twin.studies.check.text import check_pictures, check_result

    if update != bool(reason.strip()):
        raise InputRefused('twin check: --update and --reason "why the numbers may move" go together; give both')
    processes = jobs if isolate == "run" else 0
    done = outcomes(pairs(experiments, drives, baselines, update), reason, processes, say)
    verdicts = [outcome.verdict for outcome in done if outcome.verdict]
    failures = [outcome for outcome in done if outcome.failure]
    failed = [{"experiment": Path(o.pair.file).stem, "drive": o.pair.drive, "failure": o.failure} for o in failures]
    places = []
    moved = [outcome for outcome in done if outcome.text]
    for outcome in moved:
        write_baseline(
            baseline_file(Path(outcome.pair.folder), Path(outcome.pair.file).stem, outcome.pair.drive), outcome.text
        )
    if update and verdicts:
        folders = dict.fromkeys(outcome.pair.folder for outcome in done if outcome.verdict)
        places.append(f"  written  {len(moved)} of {len(verdicts)} baselines in {', '.join(folders)}")
    say("drawing and writing", 1.0)
    if any(verdict.outside for verdict in verdicts):
        places += [f"  picture  {picture}" for picture in check_pictures(verdicts, out)]
    result = check_result(verdicts, [terminal_text(outcome.failure) for outcome in failures])
    deviates = not update and any(verdict.deviations for verdict in verdicts)
    return replace(
        result,
        body=[*result.body, *([""] if places else []), *places],
        facts={"verdicts": to_dict(verdicts), "failures": failed},
        exit_code=failures[0].exit_code if failures else int(deviates),
    )
