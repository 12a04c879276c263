"""`twin identify`: springs, zeros, backlash and scale from a calibration."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.first_look import look_at_files, look_at_logs
from twin.cli.latest import tell_latest
from twin.cli.options import AsJson, ColumnMap, Columns, Formats, Settings


def identify(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A run of twin, or a CSV or MCAP file of a robot.")],
    experiment: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Experiment that describes the robot; without it, that of the run."),
    ] = None,
    maps: ColumnMap = None,
    settings: Settings = None,
    height: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Height of a level scale, if you measured it: for the zeros."),
    ] = None,
    motor_torque: Annotated[
        bool, typer.Option("--motor-torque", help="Take drive/n.tau_motor as measured: parts k_s from eta.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where files go; without it, results/identify/NAME/TIME.")
    ] = None,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Identify a robot from presses on a scale: k_s eta, zeros, backlash, friction.

    Each number has its 95 % interval; what the log does not say is named, and the
    paper's own procedure stands beside it. The log has encoders (as for twin
    replay) and scale.F_z, pressing positive. docs/identification.md tells more.
    Exit code: 0 done, 1 k_s eta cannot be had from this log, 2 input refused.

    Example: twin identify results/fig4_force_position
    """
    look_at_logs([log])
    look_at_files([experiment] if experiment else [])
    tell_latest([log])
    asked: dict[str, Any] = {
        "log": log,
        "maps": maps or [],
        "experiment": experiment,
        "settings": settings or [],
        "height": None if height is None else 1e-3 * height,
        "motor_torque": motor_torque,
        "out": out,
    }
    ask("twin.studies.identify.study:identify", asked, as_json, formats=formats, columns=columns)
