"""`twin export`: conversion of a recording for other tools."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import InputRefused
from twin.studies.command import Answer, Argument, ArgumentValues, Option, study
from twin.studies.precheck import print_latest

if TYPE_CHECKING:
    from twin.kernel.recording.export.export import Format

EXPORT_FORMATS: tuple["Format", ...] = ("csv", "parquet", "mat", "ros2")
JOINT_FIELDS = {
    "theta_l": ("joint", "position"),
    "omega_l": ("joint", "velocity"),
    "tau_l": ("joint", "effort"),
    "theta_m": ("motor", "position"),
    "omega_m": ("motor", "velocity"),
    "tau_motor": ("motor", "effort"),
}
"""Field -> shaft (joint or motor) and its quantity in a ROS 2 JointState."""


def _check_format(asked: ArgumentValues) -> None:
    chosen = [form for form in EXPORT_FORMATS if asked[form]]
    if len(chosen) != 1:
        got = " and ".join(f"--{form}" for form in chosen) or "none"
        raise InputRefused(f"twin export: expected one of --csv, --parquet, --mat and --ros2, got {got}")


@study(json=False, before=[_check_format, print_latest])
def export(
    run: Annotated[Path, Argument("A run's folder, its .mcap file, results/EXPERIMENT, or a log with --map.", "RUN")],
    csv: Annotated[bool, Option("Write comma-separated values.")] = False,
    parquet: Annotated[bool, Option("Write Apache Parquet (needs pyarrow).")] = False,
    mat: Annotated[bool, Option("Write a MATLAB file: a struct per topic.")] = False,
    ros2: Annotated[bool, Option("Write a bag of ROS 2: a folder with MCAP.")] = False,
    maps: Annotated[
        Sequence[str], Option("Signals of another tool's log, or a TOML file.", "NAME=COLUMN[UNIT]", "--map")
    ] = (),
    signals: Annotated[
        Sequence[str], Option("Signal to export, such as plant.p_B, 'plant.*', '*.F_z'; may be repeated.", "NAME")
    ] = (),
    rate: Annotated[float | None, Option("Rows per second; default: the fastest signal's rate.", "HZ")] = None,
    out: Annotated[Path | None, Option("Output file; default: next to the recording.", "PATH")] = None,
    force: Annotated[bool, Option("Replace an existing file.")] = False,
) -> Answer:
    """Write a recording as CSV, Parquet or MATLAB file, or as a bag of ROS 2.

    Numbers are SI. Each row has the newest recorded value of each signal at
    its time, without interpolation. Exit code: 0 done, 2 input refused.

    Example: twin export results/fig4_force_position --csv --rate 100
    """
    from twin.kernel.recording.export.export import export_recording

    form = next(form for form, wanted in zip(EXPORT_FORMATS, (csv, parquet, mat, ros2), strict=True) if wanted)
    exported = export_recording(run, form, signals, rate, out, force, maps, JOINT_FIELDS)
    text = f"{exported.path}  {exported.signals} signals, {exported.rows} {'messages' if ros2 else 'rows'}"
    if exported.note:
        text += f"\n  note  {exported.note}"
    return Answer(text, {"file": str(exported.path), "signals": exported.signals, "rows": exported.rows})
