"""`twin export`: a recording for other tools."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.errors import InputRefused


class Format(StrEnum):
    """What can be written, by the file's suffix."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder, its .mcap file, or results/EXPERIMENT.")],
    csv: Annotated[bool, typer.Option("--csv", help="Write comma-separated values.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Apache Parquet (needs pyarrow).")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="Write a MATLAB file: a struct per topic.")] = False,
    signals: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only these, again for each: plant.p_B, 'plant.*', '*.F_z'."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Rows per second; without it, the fastest signal's.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Without it, beside the recording.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a recording as CSV, Parquet or MATLAB file.

    Every number is SI and one that was recorded: at each row's time, the newest
    value of each signal; nothing is interpolated.
    Exit code: 0 done, 2 input refused.

    Example: twin export results/fig4_force_position --csv --rate 100
    """
    chosen = [form for form, wanted in zip(Format, (csv, parquet, mat), strict=True) if wanted]
    if len(chosen) != 1:
        raise InputRefused(f"got {len(chosen)} formats; expected one of --csv, --parquet and --mat")
    from twin.recording.export.export import export_recording

    exported = export_recording(run, chosen[0].value, signals or (), rate, out, force)
    print(f"{exported.path}  {exported.signals} signals, {exported.rows} rows")
    if exported.note:
        print(f"  note  {exported.note}")
