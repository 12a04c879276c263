"""`twin export`: a recording for other tools."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import InputRefused
from twin.studies.first_look import print_latest


class Format(StrEnum):
    """What can be written."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"
    ROS2 = "ros2"


def export(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="A run's folder, its .mcap file, results/EXPERIMENT, or a log with --map."),
    ],
    csv: Annotated[bool, typer.Option("--csv", help="Write comma-separated values.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Apache Parquet (needs pyarrow).")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="Write a MATLAB file: a struct per topic.")] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="Write a bag of ROS 2: a folder with MCAP.")] = False,
    maps: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="NAME=COLUMN[UNIT]", help="Signals of another tool's log, or a TOML file."),
    ] = None,
    signals: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only these, again for each: plant.p_B, 'plant.*', '*.F_z'."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Rows per second; without it, the fastest signal's.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="PATH", help="Without it, beside the recording.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a recording as CSV, Parquet or MATLAB file, or as a bag of ROS 2.

    Every number is SI and one that was recorded: at each row's time, the newest
    value of each signal; nothing is interpolated.
    Exit code: 0 done, 2 input refused.

    Example: twin export results/fig4_force_position --csv --rate 100
    """
    chosen = [form for form, wanted in zip(Format, (csv, parquet, mat, ros2), strict=True) if wanted]
    if len(chosen) != 1:
        got = " and ".join(f"--{form.value}" for form in chosen) or "none"
        raise InputRefused(f"twin export: expected one of --csv, --parquet, --mat and --ros2, got {got}")
    print_latest({"run": run})
    from twin.recording.export.export import export_recording

    exported = export_recording(run, chosen[0].value, signals or (), rate, out, force, maps or ())
    print(f"{exported.path}  {exported.signals} signals, {exported.rows} {'messages' if ros2 else 'rows'}")
    if exported.note:
        print(f"  note  {exported.note}")
