"""Execution of one run: the experiment is assembled, stepped in slices and recorded."""

import json
import shlex
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.atomic_write import make_folder, write_json
from twin.kernel.cosim.observers import Observer, ProgressObserver
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused
from twin.kernel.fmi.variable import FILE_PREFIX, to_json
from twin.kernel.process.real_time import share_priority
from twin.kernel.process.states import (
    RunStates,
    StoredState,
    continuation_metadata,
    identity,
    refuse_other_run,
    simulate_saving,
    state_ticks,
)
from twin.kernel.recording.folder import RECORDING_FILE
from twin.kernel.recording.recorder import BLOCK_TICKS, Recorder, versions
from twin.kernel.recording.writer import Writer
from twin.robot.assembly.assemble import IN_PROCESS_MAKER, Assembly, assemble
from twin.robot.assembly.build import DriveMaker, plant_parameters
from twin.robot.assembly.drives import DrivePlan
from twin.robot.assembly.roles import origin_metadata
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.source import FILE_KEYS, RETAINED_KEYS
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.monitor.component import trip_reason
from twin.robot.plant.component import rest_state
from twin.robot.plant.dynamics import STATE_SIZE, PlantParameters
from twin.robot.plant.equations import PlantEquations
from twin.robot.run.branch import branched_experiment, start_branch
from twin.robot.run.handover import BranchPoint
from twin.robot.run.measures import with_units
from twin.robot.run.outcome import HeldForces, RunOutcome
from twin.robot.run.trace import streams_of
from twin.robot.run.viewer import Pace, Punctuality, RemoteSide, Viewer, ViewerObserver
from twin.robot.run.watch import run_observers
from twin.robot.scene import Scene

NO_STATE_DEPENDS_ON = ("recording", "title")
"""Keys of an experiment that do not affect a saved state."""
MAX_POLE_STEP = 2.7
"""Maximum |pole| times step for stable classical Runge-Kutta: 2.78 on the real axis, 2.83 on the imaginary one."""
DERIVATIVE_STEPS = np.array([1e-7] * 3 + [1e-5] * 3 + [1e-7] * 2)
"""Steps of the numerical derivatives: m, m/s, and m of the bristle."""
PRESSED_DEPTH = 1e-3
"""Depth (m) of the platform in the surface for the evaluation of the poles in contact."""
SLICE_TICKS, SERVED_SLICE_TICKS = BLOCK_TICKS, 5 * BLOCK_TICKS
SUMMARY_FILE = "summary.json"
SERVED_KEY = "served"
"""Metadata of a recording whose drives a remote controller commanded."""
Report = Callable[[int, int], None]


def provenance(experiment: Experiment, assembly: Assembly) -> dict[str, dict[str, str]]:
    """Return the metadata on a run's origin for its recording; independent of time, place and user."""
    fmus = {
        f"{name}{'.' * bool(part)}{part}": json.dumps(
            {
                "file": fmu.path.name,
                "sha256": fmu.sha256,
                **({"compiled_with": fmu.compiler} if fmu.compiler else {}),
                "model": fmu.model.modelName,
                "fmi": fmu.model.fmiVersion,
                "generation_tool": fmu.model.generationTool,
                "kind": fmu.kind,
                "solver": solver.method if (solver := plan.solver(part)) else None,
                "solver_step": solver.step if solver else None,
                "tolerance": plan.tolerance(part),
                "stop_time": experiment.duration_ticks * experiment.cosim.tick,
                "set": {variable.name: to_json(value) for variable, value in plan.settings[part]},
                "mapped": [str(binding) for binding in plan.bindings],
            }
        )
        for name, plan in drive_plans(assembly)
        for part, fmu in plan.parts.items()
    }
    fmus |= {
        name: json.dumps(
            {"file": plan.label, "sha256": plan.system.sha256, **origin_metadata(plan.system), "set": {},
             "mapped": [str(binding) for binding in plan.bindings]}
        )
        for name, plan in drive_plans(assembly)
        if plan.system is not None
    }  # fmt: skip
    fmus |= {role: json.dumps(part.metadata) for role, part in assembly.third_party.items() if part.fmu}
    optional = {
        "python": {role: json.dumps(part.metadata) for role, part in assembly.third_party.items() if not part.fmu},
        "part": {role: part.sentence for role, part in assembly.third_party.items()},
        "substituted": assembly.substituted,
        "phases": {str(kind.value): kind.phrase for kind in PhaseKind} if experiment.tasks else {},
    }
    values = without_folders(experiment.values)
    if "controller" in assembly.substituted:
        # the gains of a replaced controller did not act
        values["controller"] = {k: v for k, v in values["controller"].items() if k in RETAINED_KEYS["controller"]}
    return {
        "experiment": {"name": experiment.name, "title": experiment.title, "values": json.dumps(values)},
        # sorted because the same experiment may be spread over files in many ways
        "origins": dict(sorted(experiment.origins.items())),
        "fmu": fmus,
        **{name: facts for name, facts in optional.items() if facts},
        "versions": versions(),
    }


def _identity_parts(provenance: dict[str, dict[str, str]]) -> tuple[dict[str, str], dict[str, str], dict[str, Any]]:
    """Return the parts that identify a run: package versions, SHA-256 of each part's file, experiment values."""
    values = json.loads(provenance["experiment"]["values"])
    values = {key: value for key, value in values.items() if key not in NO_STATE_DEPENDS_ON}
    # the name of the body file, whose values are in the table already
    values.get("contact", {}).pop("body", None)
    parts = provenance.get("fmu", {}) | provenance.get("python", {})
    return provenance["versions"], {name: json.loads(text)["sha256"] for name, text in parts.items()}, values


def drive_plans(assembly: Assembly) -> list[tuple[str, DrivePlan]]:
    """Return (component name, plan) of each joint's drive, except drives that a program has substituted."""
    if "drive" in assembly.substituted:
        return []
    named = [(f"drive_{number}", plan) for number, plan in enumerate(assembly.drives, start=1)]
    return [(name, plan) for name, plan in named if name not in assembly.substituted]


def without_folders(values: dict[str, Any]) -> dict[str, Any]:
    """Return recorded values with paths reduced to file names, as folders of this machine are private."""
    return {key: _without_folder(key, value) for key, value in values.items()}


def _without_folder(key: str, value: Any) -> Any:
    if isinstance(value, dict):
        return without_folders(value)
    if isinstance(value, (list, tuple)):
        return [_without_folder("", v) for v in value]
    if isinstance(value, str) and value.startswith(FILE_PREFIX):
        return FILE_PREFIX + Path(value.removeprefix(FILE_PREFIX)).name
    return Path(value).name if key in FILE_KEYS else value


def fast_pole_remedy(experiment: Experiment) -> str:
    """Return a sentence on how to mend an unstable integration of the plant; "" if it is stable."""
    step = experiment.cosim.tick / experiment.plant.substeps
    pole = fastest_pole(experiment)
    if not pole * step > MAX_POLE_STEP:
        return ""
    if pole == np.inf:
        return "The plant's poles are not finite: look for an absurd stiffness, mass or damping."
    needed = int(np.ceil(pole * experiment.cosim.tick / MAX_POLE_STEP))
    remedy = f"set [plant] substeps = {needed}, or " if needed <= 1000 else ""
    return (
        f"The plant's fastest pole is about {pole:.2g} 1/s, and steps of {1e6 * step:g} us ([cosim] tick_ms / [plant] "
        f"substeps) follow at most {MAX_POLE_STEP / step:.2g} 1/s: {remedy}look for a stiffness or damping that is too "
        "large or a mass that is too small."
    )


def fastest_pole(experiment: Experiment) -> float:
    """Compute the largest |eigenvalue| (1/s) of the plant linearised at rest; inf if it is not finite.

    The plant is at rest, once in the air and once pressed into the surface.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    start = np.array(experiment.start)
    x, theta_m = rest_state(parameters, start)
    poles = [_fastest_eigenvalue(parameters, x, theta_m)]
    try:
        pressed = rest_state(parameters, [*start[:2], parameters.z_s - PRESSED_DEPTH])
        poles.append(_fastest_eigenvalue(parameters, *pressed))
    except Unreachable:
        # an unreachable surface is never touched
        pass
    return max(poles)


def _fastest_eigenvalue(parameters: PlantParameters, x: np.ndarray, theta_m: np.ndarray) -> float:
    jacobian = np.empty((STATE_SIZE, STATE_SIZE))
    plant = PlantEquations(parameters)
    # dry friction is stiffest while it sticks
    plant.hold(x, theta_m)
    for i, small in enumerate(DERIVATIVE_STEPS):
        step = small * np.eye(STATE_SIZE)[i]
        jacobian[:, i] = (plant.derivative(x + step, theta_m) - plant.derivative(x - step, theta_m)) / (2.0 * small)
    if not np.isfinite(jacobian).all():
        return np.inf
    return float(np.abs(np.linalg.eigvals(jacobian)).max())


@dataclass(frozen=True)
class Run:
    """A finished and recorded run of an experiment.

    Attributes:
        recording: the MCAP file.
        simulated, stepping, writing: simulated time, wall time in the master and in the recorder (s).
        events: (time in s, level, text).
        trip: reason why the safety monitor tripped; "" if it did not.
        drives: per drive: file, FMI version, hash, mapping, warnings; without substituted drives.
        substituted, parts: descriptions of substitutes by replaced component, and of third-party parts by role.
        outcome: summary numbers of the true state.
        microseconds: wall time (us) per tick of each component, if measured.
        changed: whether parameters were changed by hand during the run; the events list the changes.
        punctuality: statistics of the deadlines; None if the run was not paced.
        held: pressing force of each task.
    """

    recording: Path
    simulated: float
    stepping: float
    writing: float
    events: tuple[tuple[float, str, str], ...]
    trip: str
    drives: tuple[str, ...]
    substituted: dict[str, str]
    outcome: RunOutcome
    microseconds: dict[str, float]
    changed: bool
    punctuality: Punctuality | None
    parts: dict[str, str] = field(default_factory=dict)
    held: tuple[HeldForces, ...] = ()

    @property
    def real_time_factor(self) -> float:
        return self.simulated / self.stepping

    def state(self, at: float) -> SavedState:
        """Return the simulation state of the run at time `at` (s), from the recording or by running again.

        Raises:
            InputRefused: the time is outside the run, or a component cannot save its state.
            ComponentFailed: a component failed before that time.
        """
        experiment = branched_experiment(self.recording)
        tick = round(at / experiment.cosim.tick)
        if not 0 <= tick <= experiment.duration_ticks:
            end = experiment.duration_ticks * experiment.cosim.tick
            raise InputRefused(f"{self.recording}: no state at {at:g} s; expected a time from 0 to {end:g} s")
        return BranchPoint(experiment, self.recording, tick).branch_state.saved_state


def execute(
    experiment: Experiment,
    folder: str | Path,
    progress: Report = lambda done, total: None,
    substitutes: Mapping[str, Any] | None = None,
    timed: bool = False,
    maker: DriveMaker = IN_PROCESS_MAKER,
    factor: float | None = None,
    viewer: Viewer | None = None,
    state: StoredState | None = None,
    remote: RemoteSide | None = None,
) -> Run:
    """Run an experiment and record it as run.mcap, with summary.json in the same folder, which is created if missing.

    Args:
        progress: called with (ticks done, total ticks) after every slice.
        substitutes: see `assemble`. The recording, the summary and every report name them.
        maker: see `assemble`.
        timed: whether to measure the wall time of each component.
        factor: simulated time per wall time, > 0; None for as fast as possible. It leaves no trace in the recording.
        viewer: live viewer, which may change parameters during the run.
        state: state to continue from; None to begin at the start.
        remote: remote controller that commands the drives; it may end the run early. None for the experiment's own.

    Raises:
        InputRefused: a drive FMU does not fit, or the state belongs to another run.
        ComponentFailed: a component failed; the rows so far stay as run.mcap.partial.
        NotWritten: the disk is full; the rows so far stay as run.mcap.partial.
    """
    path = make_folder(Path(folder)) / RECORDING_FILE
    link = remote.link if remote else None
    with assemble(experiment, substitutes, maker, state.alive if state else {}, link) as assembly:
        pace = Pace(factor, assembly.system.tick, remote is not None) if factor else None
        run = _execute_and_record(experiment, assembly, path, progress, timed, pace, viewer, state, remote)
        summary = asdict(run) | {"recording": run.recording.name, "real_time_factor": run.real_time_factor}
        # in the summary only: the recording is shared, and paths of this machine are private
        summary["typed"] = experiment.typed
        summary["outcome"]["measures"] = with_units(run.outcome.measures)
        # written before the FMUs are freed: one that crashes then must not lose the summary
        write_json(path.with_name(SUMMARY_FILE), summary)
    return run


def _execute_and_record(
    experiment: Experiment,
    assembly: Assembly,
    path: Path,
    progress: Report,
    timed: bool,
    pace: Pace | None,
    viewer: Viewer | None,
    state: StoredState | None,
    remote: RemoteSide | None,
) -> Run:
    system, last_tick = assembly.system, experiment.duration_ticks
    # at rate "controller" no signal is recorded more often than the controller's period
    streams = streams_of(system, experiment.controller_ticks if experiment.recording.rate == "controller" else 1)
    scene, own = Scene(experiment, system), run_observers(experiment, assembly)
    tuning = own.tuning
    topics, described = [stream.topic for stream in streams], provenance(experiment, assembly)
    if remote:
        topics, described[SERVED_KEY] = [*topics, *remote.topics], dict(remote.metadata)
    about, saved = identity(system, *_identity_parts(described)), state.saved_state if state else None
    if state and saved:
        if not state.branch:
            refuse_other_run(saved, about, str(state.recording))
        scene.begin_at(saved.tick)
        described |= continuation_metadata(state)
    with Writer(path, topics, system.tick, described, scene.forms) as writer, ExitStack() as stack:
        paced = pace is not None and remote is not None
        block = SERVED_SLICE_TICKS if paced else SLICE_TICKS
        recorder = Recorder(writer, streams, scene.drawings, lambda: tuning.first, paced, block)
        stack.callback(recorder.stop)
        if recorder.thread:
            share_priority(recorder.thread.native_id or 0)
        lasting = own._asdict() | {"recorder": recorder}
        asked = state_ticks(experiment.recording.states, experiment.recording.state_every, system.tick, last_tick)
        states = RunStates(asked, last_tick, system.tick, about, lasting)
        first = remote.observers(recorder, pace.deadlines if pace else None) if remote else []
        observers: list[Observer] = [*first, *lasting.values(), ProgressObserver(progress, last_tick + 1)]
        observers += [pace] if pace else []
        observers += [ViewerObserver(viewer, streams, scene, tuning)] if viewer else []
        slice_ticks = pace.slice_ticks(block) if pace else block
        branches = state is not None and state.branch
        # a branch does not inherit changes made by hand in its parent run
        going_on = {name: one for name, one in lasting.items() if not branches or one is not tuning}
        adopt = start_branch if branches else None
        done = simulate_saving(assembly, last_tick, observers, slice_ticks, states, saved, going_on, adopt, timed)
        tuning.close()
        end = last_tick if done.simulation.is_over else done.simulation.next_tick - 1
        by_remote = done.simulation.culprit == "remote" and done.simulation.next_tick > 0
        # a drive's own request to end is a failure
        if by_remote and isinstance(done.failure, EndRequest):
            recorder.end(done.failure)
            end = done.simulation.next_tick - 1
        elif done.failure:
            raise _with_remedy(experiment, done.simulation, assembly, recorder.abandon(done.failure))
        recording = recorder.finish()
    return Run(
        recording=recording,
        simulated=(end - (saved.tick if saved else 0)) * system.tick,
        stepping=done.stepping,
        writing=recorder.writing,
        events=tuple((event.tick * system.tick, event.level, event.text) for event in recorder.events),
        trip=trip_reason(done.simulation),
        drives=tuple(_describe_drive(plan) for _, plan in drive_plans(assembly)),
        substituted=assembly.substituted,
        outcome=own.tally.outcome,
        microseconds={name: 1e6 * cost for name, cost in done.costs.items()},
        changed=bool(tuning.first),
        punctuality=pace.punctuality() if pace else None,
        parts={role: part.sentence for role, part in assembly.third_party.items()},
        held=own.tally.held_forces,
    )


def _describe_drive(plan: DrivePlan) -> str:
    """Describe a drive for the recording in a few lines: files, FMI versions and hashes, mapped names, warnings."""
    lines = [f"{plan.label}  SSP {plan.system.version}  sha256 {plan.system.sha256[:12]}"] if plan.system else []
    lines += [f"{d.path.name}  {d.standard}  sha256 {d.sha256[:12]}" for d in plan.parts.values()]
    lines += [f"  {binding}" for binding in plan.bindings if binding.name != binding.port.name]
    return "\n".join([*lines, *(f"  warning: {text}" for text in plan.warnings())])


def _with_remedy(experiment: Experiment, simulation: Simulation, assembly: Assembly, what: str) -> ComponentFailed:
    sentences = [what]
    culprits = {f"drive_{number}": plan for number, plan in enumerate(assembly.drives, start=1)}
    culprits["drive"] = assembly.drives[0]
    given = simulation.inputs(simulation.system.component(simulation.culprit))
    # an encoder can only fail because of its inputs
    if simulation.culprit in ("plant", "encoder") or not np.isfinite(given).all():
        hint = fast_pole_remedy(experiment)
        sentences += [hint] if hint else []
    elif simulation.culprit in culprits:
        plan = culprits[simulation.culprit]
        fmus = [str(fmu.path) for fmu in ([plan.system] if plan.system else plan.parts.values())]
        sentences += [f"Try: {shlex.join(['twin', 'drive', 'check', fmu])}" for fmu in fmus]
    elif simulation.culprit in assembly.third_party:
        table = experiment.stand_ins[simulation.culprit]
        part = table.fmu or table.python or ""
        sentences += [f"Try: {shlex.join(['twin', 'component', 'check', simulation.culprit, part])}"]
    return ComponentFailed("\n".join(sentences))
