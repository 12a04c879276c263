"""Systems of others, tried by the survey: SSP archives, structures that lie unpacked, those of libcosim and Maestro."""

import json
import re
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused, TwinError
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.job import JobLimits
from twin.kernel.process.reporter import Reporter
from twin.kernel.ssp.package import STRUCTURE_FILE, Package
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system
from twin.kernel.systems.reading import read_system
from twin.studies.result import count_text

JOB = "validation.systems:tried"
ASKED = "as it is"
LACKING = re.compile(r"neither the structure nor an FMU states a (step size|stop time)")
OUTSIDE = re.compile(rb'"(\.\./[^"]+)"')
"""What a structure names that lies in a folder above, as libcosim allows."""
GIVEN = {"stop": 1.0, "tick": 0.01}
"""Of a system that does not state them (s)."""
MOST_STEPS = 200_000
CLOSE = 0.01
"""Of a signal's size, by which results may be missed."""


def systems_below(place: Path, scratch: Path) -> Iterator[tuple[Path, Path]]:
    """(what is called the system, what is to be read) of each below a folder; unpacked structures are packed."""
    for file in sorted(file for file in place.rglob("*") if file.is_file()):
        if file.suffix == ".ssp" or (file.name.startswith("OspSystemStructure") and file.suffix == ".xml"):
            yield file, file
        elif file.name == STRUCTURE_FILE:
            yield file, _packed(file, Path(tempfile.mkdtemp(dir=scratch)))
        elif file.suffix == ".json" and _is_multi_model(file):
            yield file, file


def _packed(structure: Path, folder: Path) -> Path:
    """An archive of all that lies beside a structure, and of FMUs that it names outside."""
    packed, home = folder / f"{structure.parent.name}.ssp", structure.parent
    with zipfile.ZipFile(packed, "w") as archive:
        text = structure.read_bytes()
        for source in sorted({one.decode() for one in OUTSIDE.findall(text)}):
            if (home / source).is_file():
                text = text.replace(f'"{source}"'.encode(), f'"outside/{Path(source).name}"'.encode())
                archive.write(home / source, f"outside/{Path(source).name}")
        archive.writestr(STRUCTURE_FILE, text)
        for one in sorted(one for one in home.rglob("*") if one.is_file() and one != structure):
            archive.write(one, one.relative_to(home).as_posix())
    return packed


def _is_multi_model(file: Path) -> bool:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return isinstance(content, dict) and {"fmus", "connections"} <= content.keys()


def system_row(name: str, file: Path, limits: JobLimits) -> dict[str, Any]:
    """What a system is and what came of trying it, in a process that may crash or hang.

    Keys: file; form; parts, how many FMUs; tried; word and detail as of an FMU.
    """
    known: dict[str, Any] = {"file": name, "form": "", "parts": 0, "tried": "nothing"}
    try:
        found = run_guarded(JOB, {"file": str(file)}, limits, known.update)
    except (JobFailure, JobLoadFailure) as failure:
        found = {"word": "lost", "detail": str(failure)}
    except ComponentFailed as failure:
        found = {"word": "failed", "detail": str(failure)}
    except TwinError as refusal:
        found = {"word": "refused", "detail": str(refusal)}
    return known | found


def tried(reporter: Reporter, file: str) -> dict[str, Any]:
    """What came of the system `file`; a job of the guard.

    Beside X.ssp there may be X_ref.csv, its results, a column for each signal, and X.toml, what is asked: `stop` and
    `tick` (s), `set`, a list of NAME=VALUE.

    Raises:
        InputRefused, ComponentFailed: the system.
    """
    path = Path(file)
    package = read_system(path)
    version = f" {package.structure.version}" if package.form == "SSP" else ""
    reporter.note(form=f"{package.form}{version}")
    beside = path.with_suffix(".toml")
    asked = tomllib.loads(beside.read_text(encoding="utf-8")) if beside.exists() else {}
    settings = asked.pop("set", [])
    results, tried_as = path.with_name(f"{path.stem}_ref.csv"), "as its test asks" if asked or settings else ASKED
    reporter.note(tried=tried_as)
    try:
        return _run(reporter, package, asked, settings, results)
    except InputRefused as refusal:
        if not LACKING.search(str(refusal)):
            raise
    asked = GIVEN | asked
    reporter.note(tried=f"{asked['stop']:g} s in steps of {1e3 * asked['tick']:g} ms, as it states none")
    return _run(reporter, package, asked, settings, results)


def _run(
    reporter: Reporter, package: Package, asked: Mapping[str, float], settings: list[str], results: Path
) -> dict[str, Any]:
    wanted = dict[str, np.ndarray]()
    if results.exists():
        head, _, _ = results.read_text(encoding="utf-8").partition("\n")
        numbers = np.loadtxt(results, delimiter=",", skiprows=1, ndmin=2)
        wanted = dict(zip(head.split(","), numbers.T, strict=True))
    times = wanted.pop("time", np.zeros(0))
    choice = MasterChoice(tick=asked.get("tick"), stop=asked.get("stop"), lenient=True)
    with open_system(package, choice, additions=Additions(settings, recorded=[*wanted])) as (plan, made):
        reporter.note(parts=len(plan.parts))
        if plan.timing.ticks - plan.timing.first > MOST_STEPS:
            raise InputRefused(f"more than {MOST_STEPS:,} steps, which is not tried")
        simulation = Simulation(made.system, plan.timing.ticks, plan.timing.ticks + 1 - plan.timing.first)
        rows = simulation.advance().copy()
        ended = isinstance(simulation.failure, EndRequest)
        if simulation.failure and not ended:
            raise simulation.failure
        steps = f"{len(rows) - 1} steps of {plan.timing.tick:g} s"
        forgiven = [*plan.forgiven, *made.forgiven]
        detail = f"{steps}{', ended by an FMU' if ended else ''}{f'; let through: {forgiven[0]}' if forgiven else ''}"
        if not wanted:
            return {"word": "ran", "detail": detail}
        places = {
            f"{part.path}.{port.variable.name}": made.columns[part.name].start + place
            for part in plan.parts
            for place, port in enumerate(part.outputs)
        }
        at = np.clip(np.rint(times / plan.timing.tick).astype(int) - plan.timing.first, 0, len(rows) - 1)
        worst, named = -1.0, ""
        for name, theirs in wanted.items():
            own = rows[:, places[name]]
            size = max(float(np.abs(theirs).max()), float(np.ptp(own)), 1e-12)
            off = float(np.abs(own[at] - theirs).max()) / size
            if not off <= worst:
                worst, named = off, name
        word = "agrees" if worst <= CLOSE else "differs"
        return {"word": word, "detail": f"{detail}; {count_text(len(wanted), 'signal')}, {named} off by {worst:.2g}"}
