"""An SSP archive in, a recording out.

A topic for each component of a system: its outputs, elements of an array as one signal again.
"""

import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.cosim.observers import Messages, Progress, Simulated, TickEvent, simulate
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.fmi.description import build
from twin.kernel.fmi.setting import told
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.process.reporter import Reporter
from twin.kernel.recording.folder import RECORDING, claim_run_folder, create_run_folder
from twin.kernel.recording.layout import Field, Topic
from twin.kernel.recording.recorder import BLOCK_TICKS, Recorder, RowStream, versions
from twin.kernel.recording.schema import message_names
from twin.kernel.recording.writer import Writer
from twin.kernel.ssp.flat import flattened
from twin.kernel.ssp.package import Package, read_package
from twin.kernel.writing import made_folder, write_bytes
from twin.studies.result import Result
from twin.studies.systems.coupled import Coupled, coupled
from twin.studies.systems.plan import Part, Plan, distinct, element, field, fmu_sources, planned
from twin.studies.systems.text import facts, system_result


def streams(plan: Plan, system: System) -> list[RowStream]:
    """In the order of the components; none of one that has no outputs."""
    columns = {
        part.name: slice(int(system.y_start[c]), int(system.y_start[c + 1])) for c, part in enumerate(plan.parts)
    }
    return [RowStream(topic, columns[topic.name]) for topic in topics(plan)]


def topics(plan: Plan) -> list[Topic]:
    """The same before there is a system.

    Raises:
        InputRefused: two components have names that a recording cannot tell apart.
    """
    found = [Topic(part.name, tuple(_fields(part)), 1) for part in plan.parts if part.outputs]
    try:
        message_names(found)
    except ValueError as problem:
        raise InputRefused(f"{plan.package.file}: {problem}; give components names that are less alike") from None
    return found


def _fields(part: Part) -> list[Field]:
    groups = _arrays(part.outputs)
    names = distinct(field(element(group[0].variable.name)[0] if len(group) > 1 else group[0].variable.name, part.path)
                     for group in groups)  # fmt: skip
    return [
        Field(name, sum(p.port.size for p in group), group[0].port.kind, group[0].port.unit, group[0].port.meaning)
        for name, group in zip(names, groups, strict=True)
    ]


def _arrays(ports: tuple[FmuPort, ...]) -> list[list[FmuPort]]:
    """Ports one after the other, `X[1]`, `X[2]` .. of one kind and unit together."""
    groups: list[list[FmuPort]] = []
    for port in ports:
        array, number = element(port.variable.name)
        last = groups[-1] if groups else []
        like = last and (last[0].port.kind, last[0].port.unit) == (port.port.kind, port.port.unit)
        if like and element(last[0].variable.name) == (array, 1) and number == len(last) + 1 and port.port.size == 1:
            last.append(port)
        else:
            groups.append([port])
    return groups


HOME = Path("results/cosim")
"""Apart from runs of the robot: a system is often called as the experiment that it was built from."""


def recorded_system(
    reporter: Reporter,
    system: Path,
    tick: float | None = None,
    stop: float | None = None,
    scheme: Scheme = "gauss_seidel",
    out: Path | None = None,
    compiled: bool = False,
) -> Result:
    """Run the system of an SSP archive and record it.

    Notes: {"experiment": its name, "folder", "duration" (s)} before the first step.

    Args:
        system: the archive.
        tick: length of a step (s); None: as the system says.
        stop: end of the run (s); None: likewise.
        scheme: "gauss_seidel" in the order of the components in the file, or "jacobi".
        out: the run's own folder; None: results/NAME/TIME.
        compiled: whether FMUs without a binary for this machine are built from their sources.

    Raises:
        InputRefused: the system cannot be run; nothing has been written.
        ComponentFailed: a component failed; what was recorded stays.
        NotWritten: the disk is full; likewise.
    """
    reporter.loading()
    package = read_package(system)
    with opened(package, tick, stop, scheme, compiled) as (plan, made):
        folder = _folder(package.file, out)
        # absolute: an FMU may change the working directory
        path = folder.absolute() / RECORDING
        duration = plan.timing.ticks * plan.timing.tick
        reporter.note(experiment=package.file.stem, folder=str(path.parent), duration=duration)
        done, events, writing = _recorded(plan, made, path, reporter)
        came = facts(plan, made, done, events, writing, folder / RECORDING)
    return system_result(came)


@contextmanager
def opened(
    package: Package,
    tick: float | None = None,
    stop: float | None = None,
    scheme: Scheme = "gauss_seidel",
    compiled: bool = False,
) -> Iterator[tuple[Plan, Coupled]]:
    """The system of an archive, planned and ready to be run; arguments but `package` as of `recorded_system`.

    Raises:
        InputRefused: as `recorded_system`.
    """
    scratch = tempfile.mkdtemp()
    with _named(package, scratch):
        try:
            plan = _planned(package, Path(scratch), tick, stop, scheme, compiled)
            folders = {one.sha256: unpacked(one.path, one.sha256) for one in (part.description for part in plan.parts)}
        finally:
            # before anything is loaded: what crashes would leave it
            shutil.rmtree(scratch, ignore_errors=True)
        with coupled(plan, folders) as made:
            yield plan, made


def _planned(
    package: Package, scratch: Path, tick: float | None, stop: float | None, scheme: Scheme, compiled: bool
) -> Plan:
    flat = flattened(package.structure, f"{package.file}")
    files: dict[str, Path] = {}
    for entry in fmu_sources(package, flat).values():
        if entry not in files:
            files[entry] = scratch / entry
            made_folder(files[entry].parent)
            write_bytes(files[entry], package.content(entry))
            if compiled:
                build(files[entry])
    plan = planned(package, flat, files, tick, stop, scheme)
    # refuses names that a recording cannot hold, before there is one
    topics(plan)
    return plan


@contextmanager
def _named(package: Package, scratch: str) -> Iterator[None]:
    """Sentences of the block that tell of files in `scratch` tell of the archive instead."""
    try:
        yield
    except TwinError as error:
        # how to build a file that the archive holds
        text = re.sub(rf"twin drive info {re.escape(scratch)}/\S+ --compile builds", "--compile builds", str(error))
        error.args = (text.replace(f"{scratch}/", f"{package.file}: "),)
        raise


def _folder(file: Path, out: Path | None) -> Path:
    return claim_run_folder(out) if out else create_run_folder(HOME, file.stem, datetime.now())


def _recorded(plan: Plan, made: Coupled, path: Path, reporter: Reporter) -> tuple[Simulated, list[TickEvent], float]:
    rows = streams(plan, made.system)
    with Writer(path, [stream.topic for stream in rows], plan.timing.tick, _provenance(plan)) as writer:
        recorder = Recorder(writer, rows)
        observers = [Messages(made.system), recorder, Progress(reporter.progress, plan.timing.ticks + 1)]
        done = simulate(made, plan.timing.ticks, observers, BLOCK_TICKS, timed=True)
        if done.failure:
            raise ComponentFailed(recorder.abandon(done.failure))
        recorder.finish()
    return done, recorder.events, recorder.writing


def _provenance(plan: Plan) -> dict[str, dict[str, str]]:
    """What a recording says of its origin; nothing in it depends on when, where or by whom it was made."""
    return {
        "system": {
            "file": plan.package.file.name,
            "sha256": plan.package.sha256,
            "name": plan.package.structure.system.name,
            "ssp": plan.package.structure.version,
            "scheme": plan.scheme,
            "tick": repr(plan.timing.tick),
            "order": json.dumps([part.path for part in plan.parts]),
            "wires": json.dumps(plan.wires),
        },
        "components": {
            part.path: json.dumps(
                {
                    "file": part.description.path.name,
                    "sha256": part.description.sha256,
                    "model": part.description.model.modelName,
                    "fmi": part.description.model.fmiVersion,
                    "generation_tool": part.description.model.generationTool,
                    "set": {variable.name: told(value) for variable, value in part.settings},
                }
            )
            for part in plan.parts
        },
        "versions": versions(),
    }
