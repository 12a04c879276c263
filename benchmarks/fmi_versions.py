"""What FMI 3.0 costs beyond FMI 2.0: the same servo, the same sources, built as both with the same compiler."""

import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from benchmarks.macro_step import TICKS, master_seconds
from benchmarks.measurement import Measurement, Rounds
from twin.experiment.schema import Drive as DriveTable
from twin.runs.assembly.drives import planned

ROUNDS = 31
FMUS = Path(__file__).parents[1] / "fmus"
BINARIES = {"2.0": "linux64", "3.0": "x86_64-linux"}


def built(name: str, fmi: str, folder: Path, compiler: str) -> Path:
    """`name` of fmus/ as an FMU of version `fmi`, for this machine only."""
    sys.path.insert(0, str(FMUS))
    from builder.compile import write_generated
    from builder.drive import load_drive
    from builder.model_description import model_description
    from builder.model_description_fmi3 import model_description_fmi3

    drive = replace(load_drive(name), fmi=fmi)
    scratch = folder / fmi
    write_generated(drive, scratch)
    fmpy = find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    ceremony = FMUS / f"fmi{fmi[0]}"
    sources = [FMUS / name / "model.c", *sorted(ceremony.glob("*.c")), scratch / "variables.c"]
    includes = [f"-I{path}" for path in (scratch, ceremony, FMUS / "fmi2", Path(fmpy.origin).parent / "c-code")]
    library = scratch / f"{name}.so"
    command = [compiler, "-O2", "-shared", "-fPIC", *includes, *map(str, sources), "-lm", "-o", str(library)]
    subprocess.run(command, check=True, capture_output=True)
    describe = model_description if fmi == "2.0" else model_description_fmi3
    fmu = folder / f"{name}_{fmi[0]}.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", describe(drive))
        archive.write(library, f"binaries/{BINARIES[fmi]}/{name}.so")
    return fmu


def measurements() -> list[Measurement]:
    """The lines of the table."""
    title = "velocity_servo: FMI 3.0 / FMI 2.0, macro step"
    compiler = shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        return [Measurement(title, None, "x", at_most=1.5, remark="FMI versions: needs Linux and a C compiler")]
    with tempfile.TemporaryDirectory() as scratch:
        plans = {
            fmi: planned(DriveTable.model_validate({"fmu": str(built("velocity_servo", fmi, Path(scratch), compiler))}))
            for fmi in BINARIES
        }
        rounds = Rounds(
            {
                "two": lambda: master_seconds(plans["2.0"], TICKS + 1)[0],
                "three": lambda: master_seconds(plans["3.0"], TICKS + 1)[0],
            },
            ROUNDS,
        )
    return [
        Measurement("velocity_servo: FMI 3.0, macro step", 1e9 * rounds.typical("three") / TICKS, "ns"),
        Measurement(title, rounds.ratio("three", "two"), "x", at_most=1.5),
    ]
