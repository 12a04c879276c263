"""What FMI 3.0 costs beyond FMI 2.0, and event mode beyond none: the same servo, built with the same compiler."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from benchmarks.macro_step import TICKS, master_seconds
from benchmarks.measurement import Measurement, Rounds
from twin.robot.assembly.drives import DrivePlan, plan_drive
from twin.robot.experiment.schema import Drive as DriveTable

ROUNDS = 31
FMUS = Path(__file__).parents[1] / "fmus"
BINARIES = {"2.0": "linux64", "3.0": "x86_64-linux"}


IN_EVENT_MODE = """
fmi3Status fmi3EnterEventMode(fmi3Instance i) { return (void)i, fmi3OK; }
fmi3Status fmi3EnterStepMode(fmi3Instance i) { return (void)i, fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *planned, fmi3Float64 *next)
{
    (void)i, (void)next;
    *again = *terminate = *nominals = *values = *planned = false;
    return fmi3OK;
}
"""
"""An event mode in which nothing happens."""


def with_event_mode(text: str) -> str:
    """A source of fmus/fmi3 that offers event mode."""
    text = re.sub(
        r"REFUSE(_PLAIN)?\((fmi3Enter(Event|Step)Mode|fmi3UpdateDiscreteStates), NO_EVENTS[^;{}]*?\)\n", "", text
    )
    text = text.replace("if (event_mode_used) {", "if (false) {")
    return text + IN_EVENT_MODE if "NO_EVENTS" in text else text


def built(name: str, fmi: str, folder: Path, compiler: str, events: bool = False) -> Path:
    """`name` of fmus/ as an FMU of version `fmi`, for this machine only; with an event mode, if that is 3.0."""
    sys.path.insert(0, str(FMUS))
    from builder.compile import write_generated
    from builder.drive import load_drive
    from builder.model_description import model_description
    from builder.model_description_fmi3 import model_description_fmi3

    drive = replace(load_drive(name), fmi=fmi)
    scratch = folder / f"{fmi}_{events}"
    write_generated(drive, scratch)
    fmpy = find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    ceremony = FMUS / f"fmi{fmi[0]}"
    for path in ceremony.glob("*.c"):
        text = path.read_text()
        (scratch / path.name).write_text(with_event_mode(text) if events else text)
    sources = [FMUS / name / "model.c", *sorted(scratch.glob("*.c"))]
    includes = [f"-I{path}" for path in (scratch, ceremony, FMUS / "fmi2", Path(fmpy.origin).parent / "c-code")]
    library = scratch / f"{name}.so"
    command = [compiler, "-O2", "-shared", "-fPIC", *includes, *map(str, sources), "-lm", "-o", str(library)]
    subprocess.run(command, check=True, capture_output=True)
    describe = model_description if fmi == "2.0" else model_description_fmi3
    fmu = folder / f"{name}_{fmi[0]}_{events}.fmu"
    description = describe(drive)
    if events:
        description = description.replace(b'hasEventMode="false"', b'hasEventMode="true"')
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{BINARIES[fmi]}/{name}.so")
    return fmu


def measurements() -> list[Measurement]:
    """The lines of the table."""
    title = "velocity_servo: FMI 3.0 / FMI 2.0, macro step"
    eventful = "velocity_servo: event mode without events"
    compiler = shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        remark = "FMI versions: needs Linux and a C compiler"
        return [
            Measurement(title, None, "x", at_most=1.5, remark=remark),
            Measurement(eventful, None, "x", at_most=1.1, remark=remark),
        ]
    kinds = {"two": ("2.0", False), "three": ("3.0", False), "events": ("3.0", True)}
    with tempfile.TemporaryDirectory() as scratch:
        fmus = {kind: built("velocity_servo", fmi, Path(scratch), compiler, on) for kind, (fmi, on) in kinds.items()}
        plans = {kind: plan_drive(DriveTable.model_validate({"fmu": str(fmu)})) for kind, fmu in fmus.items()}
        rounds = Rounds({kind: partial(_seconds, plan) for kind, plan in plans.items()}, ROUNDS)
    return [
        Measurement("velocity_servo: FMI 3.0, macro step", 1e9 * rounds.typical("three") / TICKS, "ns"),
        Measurement(title, rounds.ratio("three", "two"), "x", at_most=1.5),
        Measurement(eventful, rounds.ratio("events", "three"), "x", at_most=1.1),
    ]


def _seconds(plan: DrivePlan) -> float:
    return master_seconds(plan, TICKS + 1)[0]
