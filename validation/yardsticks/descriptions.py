"""What others who check FMUs have to say of the parts that `twin build` writes."""

import logging
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

from validation.masters.robot import PLACE, ROOT
from validation.yardstick import Yardstick

PARTS = ("plant", "computer")
VERSIONS = ("2.0", "3.0")


@cache
def built() -> Mapping[str, Path]:
    """Plant and computer of the massage, which has all that a robot can have, in both versions of FMI."""
    from twin.studies.build.fmu import build_fmu

    folder = PLACE / "checked"
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for part in PARTS:
        for version in VERSIONS:
            file = folder / f"{part}_{version[0]}.fmu"
            build_fmu(ROOT / "experiments" / "massage.toml", part, version, (), file, [], lambda what: None)
            found[f"{part}, FMI {version}"] = file
    return found


def fmpy_complaints(file: Path) -> int:
    """How much FMPy's validation finds: schema, names, structure, start values, causalities, units."""
    from fmpy.validation import validate_fmu

    return len(validate_fmu(str(file)))


def toolbox_complaints(file: Path) -> int:
    """How many errors the FMU Manipulation Toolbox tells: schema, and the standard's rules that no schema can say."""
    from fmu_manipulation_toolbox.checker import get_checkers
    from fmu_manipulation_toolbox.operations import FMU

    complaints: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            complaints.append(record.getMessage())

    listener, logger = Listener(logging.ERROR), logging.getLogger("fmu_manipulation_toolbox")
    logger.addHandler(listener)
    try:
        with FMU(str(file)) as fmu:
            for checker in get_checkers():
                fmu.apply_operation(checker())
    finally:
        logger.removeHandler(listener)
    return len(complaints)


def complaints(count: Callable[[Path], int]) -> Mapping[str, float]:
    return {name: float(count(file)) for name, file in built().items()}


YARDSTICKS = tuple(
    Yardstick(
        "plant and computer of the massage as FMUs, FMI 2.0 and 3.0, checked",
        source,
        "complaints",
        0.0,
        "an FMU is as its standard wants it or is not",
        partial(complaints, count),
        (package,),
    )
    for source, package, count in (
        ("FMPy, Dassault Systèmes", "fmpy", fmpy_complaints),
        ("FMU Manipulation Toolbox, Renault", "fmu-manipulation-toolbox", toolbox_complaints),
    )
)
