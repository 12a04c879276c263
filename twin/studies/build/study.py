"""`twin build`: parts of the robot as FMUs, SSP archives and C."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from twin.kernel.errors import InputRefused
from twin.studies.command import Answer, Argument, ArgumentValues, DriveName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments


def _check_options(asked: ArgumentValues) -> None:
    if asked["c"] + asked["ssp"] + (asked["fmu"] is not None) != 1:
        raise InputRefused("twin build: expected one of --fmu PART, --c and --ssp")
    if asked["drive"] is not None and not asked["ssp"]:
        raise InputRefused("twin build: --drive belongs to a whole robot; leave it out, or add --ssp")
    if asked["c"] and asked["fmi"] is not None:
        raise InputRefused("twin build --c: --fmi belongs to an FMU; leave it out")


@study(isolated=True, before=[_check_options, load_experiments])
def build(
    experiment: Annotated[Path, Argument("File or name.", "EXPERIMENT", complete="experiment")],
    say: Say,
    fmu: Annotated[
        str | None, Option("The part to export as an FMU: plant, computer, or a component such as encoder.", "PART")
    ] = None,
    c: Annotated[bool, Option("Export the controller as C: encoder counts in, motor speeds out.")] = False,
    ssp: Annotated[bool, Option("Export the whole robot with its drives as an SSP.")] = False,
    fmi: Annotated[Literal["2", "3"] | None, Option("Version of FMI; default: 2.")] = None,
    platforms: Annotated[
        Sequence[str],
        Option("Another platform: aarch64-linux, x86_64-windows .. or all; may be repeated.", "NAME", "--platform"),
    ] = (),
    out: Annotated[
        Path | None, Option("Output; default: results/build/EXPERIMENT/PART.fmu, c, or EXPERIMENT.ssp.", "PATH")
    ] = None,
    drive: DriveName = None,
    settings: Settings = (),
) -> Answer:
    """Build a part of the robot for other programs: native code without Python.

    --fmu plant: a co-simulation FMU of springs, mechanism, contact, body,
    scale. --fmu computer: one of encoders, estimator, controller, delay,
    monitor. --c: the same from the encoders' counts on, as C with static
    libraries. --ssp: plant, computer and the unchanged drives as an SSP
    archive; this loads the libraries of the drives' FMUs.

    Built for x86-64 Linux and the platforms of --platform. The experiment's
    numbers stay open as parameters, with the names of the file.

    Exit code: 0 written, 2 refused, 3 it could not be written.

    Example: twin build fig4_force_position --fmu plant --fmi 3
    """
    version = f"{fmi or 2}.0"
    if c:
        from twin.studies.build.library import build_c

        return build_c(experiment, platforms, out, settings, say)
    if ssp:
        from twin.studies.build.system import build_ssp

        return build_ssp(experiment, version, platforms, out, drive, settings, say)
    from twin.studies.build.fmu import build_fmu

    assert fmu is not None
    return build_fmu(experiment, fmu, version, platforms, out, settings, say)
