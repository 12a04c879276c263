"""`twin replay`: a robot's log through the twin."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.first_look import look_at_files, look_at_logs
from twin.cli.latest import tell_latest
from twin.cli.options import AsJson, ColumnMap, Columns, Formats, Settings


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A CSV or MCAP file of a robot, or a run of twin.")],
    experiment: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Experiment that describes the robot; without it, that of the run."),
    ] = None,
    maps: ColumnMap = None,
    settings: Settings = None,
    plant: Annotated[
        bool, typer.Option("--plant", help="Let the plant model run, driven by the log's motor angles.")
    ] = False,
    baseline: Annotated[
        str,
        typer.Option(
            metavar="S", help="What says what is normal, best in free air: so much of the beginning, or FROM:TO."
        ),
    ] = "1",
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="N", help="Change of the force that is no news; without it, what rounding can do."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where files go; without it, results/replay/NAME/TIME.")
    ] = None,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Replay a robot's log: position, force, and whether the twin still matches.

    The log has encoder counts (encoder.count_m[0..2], encoder.count_l[0..2]) or
    angles (estimator.theta_m[0..2], estimator.theta_l[0..2]), and may have a
    measured force (scale.F_z, pressing positive).
    Exit code: 0 done, 1 robot and twin part, 2 input refused, 3 the plant model
    left the workspace.

    Example: twin replay results/fig4_force_position --plant
    """
    look_at_logs([log])
    look_at_files([experiment] if experiment else [])
    from twin.studies.replay.normal import normal_time

    tell_latest([log])
    asked: dict[str, Any] = {
        "log": log,
        "maps": maps or [],
        "experiment": experiment,
        "settings": settings or [],
        "plant": plant,
        "baseline": normal_time(baseline),
        "tolerance": tolerance,
        "out": out,
    }
    ask("twin.studies.replay.study:replay", asked, as_json, formats=formats, columns=columns)
