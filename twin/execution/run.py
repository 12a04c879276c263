"""One run: an experiment assembled, stepped in slices, recorded as it goes."""

import re
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from twin.assembly.assemble import HERE, Assembly, assemble
from twin.assembly.build import DriveMaker
from twin.assembly.drives import DrivePlan
from twin.cosim.component import Component
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.errors import ComponentFailed
from twin.execution.block import Block
from twin.execution.fastest_pole import too_fast
from twin.execution.outcome import Outcome, Tally
from twin.execution.pacing import Pace, Punctuality
from twin.execution.provenance import driven, provenance
from twin.execution.tuning import Tuning
from twin.execution.viewer import Stream, Viewer
from twin.execution.watch import Event, Watch
from twin.experiment.experiment import Experiment
from twin.recording.folder import RECORDING
from twin.recording.layout import Field, Topic
from twin.recording.writer import Writer
from twin.scene.scene import Scene
from twin.writing import write_json

SLICE_TICKS = 100
SUMMARY = "summary.json"

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        recording: the MCAP file.
        simulated, stepping, writing: simulated time, wall time in the master and in the recorder (s).
        events: (time in s, level, text).
        trip: why the safety monitor tripped; "" if it did not.
        drives: what stood behind each joint: file, FMI version, hash, mapping, warnings; nothing for a substitute.
        substituted: what took the place of the experiment's own components, by their names.
        outcome: what it came to.
        microseconds: wall time per tick of each component, if it was measured.
        changed: whether parameters were changed while it ran; the events say which and when.
        punctuality: how its deadlines were kept; None if it was not paced.
    """

    recording: Path
    simulated: float
    stepping: float
    writing: float
    events: tuple[tuple[float, str, str], ...]
    trip: str
    drives: tuple[str, ...]
    substituted: dict[str, str]
    outcome: Outcome
    microseconds: dict[str, float]
    changed: bool
    punctuality: Punctuality | None

    @property
    def real_time_factor(self) -> float:
        return self.simulated / self.stepping


def execute(
    experiment: Experiment,
    folder: str | Path,
    progress: Progress = lambda done, total: None,
    substitutes: Mapping[str, Component] | None = None,
    timed: bool = False,
    maker: DriveMaker = HERE,
    factor: float | None = None,
    viewer: Viewer | None = None,
) -> Run:
    """Run `experiment` and record it as `folder`/run.mcap, with a summary beside it.

    Args:
        experiment: checked.
        folder: the run's own folder.
        progress: told (ticks done, ticks in all) after every slice.
        substitutes: see `assemble`. The recording, the summary and every report name them.
        timed: measure each component.
        maker: see `assemble`.
        factor: simulated time per wall time, > 0; None: as fast as it goes. It leaves no trace in the recording.
        viewer: who watches while it goes on, and may change parameters.

    Raises:
        InputRefused: a drive FMU does not fit.
        ComponentFailed: a component failed; what was recorded stays as run.mcap.partial.
        NotWritten: the disk is full; likewise.
    """
    folder = Path(folder)
    with assemble(experiment, substitutes, maker) as assembly:
        pace = Pace(factor, assembly.system.tick) if factor else None
        run = _recorded(experiment, assembly, folder / RECORDING, progress, timed, pace, viewer)
        summary = asdict(run) | {"recording": run.recording.name, "real_time_factor": run.real_time_factor}
        # before the FMUs are freed: one that crashes then shall take nothing with it
        write_json(folder / SUMMARY, summary)
    return run


def _recorded(
    experiment: Experiment,
    assembly: Assembly,
    path: Path,
    progress: Progress,
    timed: bool,
    pace: Pace | None,
    viewer: Viewer | None,
) -> Run:
    system = assembly.system
    slice_ticks = pace.slice_ticks(SLICE_TICKS) if pace else SLICE_TICKS
    simulation = Simulation(system, experiment.duration_ticks, slice_ticks, timed)
    streams = [Stream(_topic(component, experiment), _span(system, c)) for c, component in enumerate(system.components)]
    watch, scene, tally = Watch(assembly, experiment), Scene(experiment, system), Tally(system)
    tuning = Tuning(experiment, assembly)
    events: list[Event] = []
    block = Block(SLICE_TICKS, system.outputs_width)
    stepping, writing, marked = 0.0, 0.0, False
    topics = [stream.topic for stream in streams]
    with Writer(path, topics, system.tick, provenance(experiment, assembly), scene.forms) as writer:
        if viewer:
            viewer.begin(streams, scene, system.tick, tuning)
        if pace:
            pace.begin()
        while not simulation.finished:
            first = simulation.next_tick
            changes = tuning.apply(first)
            if changes and not marked:
                # whoever repeats the experiment will not get this run
                writer.write_metadata("changed", {"first": changes[0].text, "all": "the events of 'tuning'"})
                marked = True
            began = time.perf_counter()
            rows = simulation.advance()
            stepped = time.perf_counter()
            scheduled = tuning.scheduled(first, simulation.next_tick)
            happened = [*changes, *sorted([*scheduled, *watch.events(first, rows)], key=lambda event: event.tick)]
            block.add(rows, happened)
            tally.take(rows)
            events += happened
            if block.full or simulation.finished:
                _write(writer, streams, scene, block)
            stepping += stepped - began
            writing += time.perf_counter() - stepped
            progress(simulation.next_tick, experiment.duration_ticks + 1)
            if pace:
                pace.keep(simulation.next_tick)
            if viewer:
                viewer.show(first, rows, happened)
        tuning.close()
        if simulation.failure:
            writer.write_event(simulation.next_tick, "ERROR", str(simulation.failure), "cosim")
            raise _with_remedy(experiment, simulation, assembly, writer.abandon())
        began = time.perf_counter()
        recording = writer.finish()
        writing += time.perf_counter() - began
    share = 1e6 * stepping / max(1, simulation.cycles.sum()) / (experiment.duration_ticks + 1)
    return Run(
        recording=recording,
        simulated=experiment.duration_ticks * system.tick,
        stepping=stepping,
        writing=writing,
        events=tuple((event.tick * system.tick, event.level, event.text) for event in events),
        trip=watch.trip,
        drives=tuple(_told(plan) for _, plan in driven(assembly)),
        substituted=assembly.substituted,
        outcome=tally.outcome,
        microseconds={c.name: float(n * share) for c, n in zip(system.components, simulation.cycles, strict=False)},
        changed=tuning.changed,
        punctuality=pace.punctuality() if pace else None,
    )


def _write(writer: Writer, streams: Sequence[Stream], scene: Scene, block: Block) -> None:
    """Record `block` and clear it."""
    for stream in streams:
        start = -block.first % stream.topic.period
        rows = block.rows[start :: stream.topic.period, stream.columns]
        writer.write(stream.topic.name, block.first + start, rows)
    for drawing in scene.drawings(block.first, block.rows):
        writer.write(*drawing)
    for event in block.events:
        writer.write_event(event.tick, event.level, event.text, event.source)
    # a component may take this process with it in the next slice
    writer.end_slice()
    block.clear()


def _told(plan: DrivePlan) -> str:
    """A drive in a few lines: files, FMI versions and hashes, foreign names, warnings."""
    lines = [f"{d.path.name}  FMI {d.model.fmiVersion}  sha256 {d.sha256[:12]}" for d in plan.parts.values()]
    lines += [f"  {binding}" for binding in plan.bindings if binding.name != binding.port.name]
    return "\n".join([*lines, *(f"  warning: {text}" for text in plan.warnings())])


def _topic(component: Component, experiment: Experiment) -> Topic:
    """`drive_1` is recorded as the topic drive/1, `fault_1` as fault/1, everything else under its own name.

    At the rate "controller" nothing is recorded more often than the controller acts.
    """
    shortest = experiment.controller_ticks if experiment.recording.rate == "controller" else 1
    name = re.sub(r"^(drive|fault)_", r"\1/", component.name)
    fields = tuple(Field(p.name, p.size, p.kind, p.unit, p.meaning) for p in component.outputs)
    return Topic(name, fields, max(shortest, component.period))


def _span(system: System, position: int) -> slice:
    return slice(int(system.y_start[position]), int(system.y_start[position + 1]))


def _with_remedy(experiment: Experiment, simulation: Simulation, assembly: Assembly, partial: Path) -> ComponentFailed:
    until = max(0, simulation.next_tick - 1) * simulation.system.tick
    sentences = [f"{simulation.failure}\nRecorded until then: {partial} ({until:.3f} s)."]
    culprits = dict(zip(("drive_1", "drive_2", "drive_3"), assembly.drives, strict=True)) | {
        "drive": assembly.drives[0]
    }
    known = {component.name: component for component in simulation.system.components}
    if simulation.culprit == "plant" or not np.isfinite(simulation.inputs(known[simulation.culprit])).all():
        hint = too_fast(experiment)
        sentences += [hint] if hint else []
    elif simulation.culprit in culprits:
        fmus = [str(fmu.path) for fmu in culprits[simulation.culprit].parts.values()]
        sentences += [f"Try: {shlex.join(['twin', 'drive', 'check', fmu])}" for fmu in fmus]
    return ComponentFailed("\n".join(sentences))
