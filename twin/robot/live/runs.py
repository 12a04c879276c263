"""Job of `twin run`: runs experiments, records them, and serves them to viewers with `--live`."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.kernel.process.guard import JobFailure
from twin.kernel.process.job import JobLimits, recording_status
from twin.kernel.process.reporter import Reporter
from twin.kernel.process.states import StoredState, machine_identity, refuse_other_run, split_time, stored_state
from twin.kernel.recording.folder import discard_run_folder, new_run_folder, recording_in
from twin.kernel.recording.reader import read_metadata
from twin.kernel.recording.recorder import versions
from twin.kernel.units import parse_float
from twin.robot.assembly.assemble import IN_PROCESS_MAKER
from twin.robot.assembly.build import DriveMaker, need_processes, planned_drives
from twin.robot.assembly.load import load_experiment, recorded_experiment
from twin.robot.experiment.differences import robot_values
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.cost import refuse_endless
from twin.robot.run.run import Run, execute
from twin.robot.run.viewer import Viewer

if TYPE_CHECKING:
    from twin.robot.live.server import LiveServer


def recorded_runs(
    reporter: Reporter,
    experiments: list[str],
    settings: list[str],
    drive: str | None,
    body: str | None,
    out: str | None,
    isolate_drives: bool = False,
    limit_step: float = JobLimits.step,
    factor: float | None = None,
    sure: bool = False,
    viewer: Viewer | None = None,
    start_from: str | None = None,
    results: str = "results",
) -> None:
    """Run experiments one after the other and record them, as the job of `twin run`.

    Notes: {"experiment", "folder", "duration" (s)} before a run, {"run": the fields of `twin.robot.run.Run` and
    `remarks`, sentences about it} after it.

    Args:
        experiments: files or names.
        settings, drive, body: see `load_experiment`, applied to all of them.
        out: folder of the only run; None for <results>/<experiment>/<time>.
        isolate_drives: whether each drive gets its own process, with the timeout `limit_step` (s) for each call.
        factor, viewer: see `execute`.
        sure: whether very long runs, and runs that may fill the disk, are confirmed.
        start_from: run to continue, optionally with @ and the time (s) of its state; replaces experiments, and allows
            no other setting than duration_s.

    Raises:
        InputRefused: an experiment has errors, or its size is not confirmed; no experiment has been run.
        ComponentFailed, RecordingFailed: see `execute`.
        SafetyTrip: the monitor tripped in an experiment without faults; all have been run.
    """
    loaded, state, remarks = [load_experiment(Path(path), settings, drive, body) for path in experiments], None, []
    if start_from is not None:
        experiment, state, how = load_continuation(start_from, settings)
        loaded, remarks = [experiment], [how]
    if not sure:
        refuse_endless(loaded, factor)
    unexpected: list[str] = []
    for experiment in loaded:
        run = record_run(
            reporter, experiment, out, isolate_drives, limit_step, results, factor=factor, viewer=viewer, state=state
        )
        reporter.note(run=run_facts(experiment, run, remarks))
        if run.trip and not experiment.faults:
            unexpected.append(f"{experiment.name}: {run.trip}")
    if unexpected:
        raise SafetyTrip("\n".join(unexpected))


def record_run(
    reporter: Reporter,
    experiment: Experiment,
    out: str | None,
    isolate_drives: bool = False,
    limit_step: float = JobLimits.step,
    results: str = "results",
    **execution: Any,
) -> Run:
    """Run an experiment in a folder of its own; notes {"experiment", "folder", "duration" (s)} before it.

    `recorded_runs` and `execute` document the other arguments.

    Raises:
        InputRefused: the experiment has errors; a folder without a name by the user is removed.
        ComponentFailed, RecordingFailed: see `execute`; the message has the state of the recording.
    """
    reporter.loading()
    # absolute, as an FMU may change the working directory
    folder = new_run_folder(out, Path(results), experiment.name).absolute()
    duration = experiment.duration_ticks * experiment.cosim.tick
    reporter.note(experiment=experiment.name, folder=str(folder), duration=duration)
    try:
        makers: AbstractContextManager[DriveMaker] = nullcontext(IN_PROCESS_MAKER)
        if isolate_drives or need_processes(planned_drives(experiment)):
            # imported here, as its compiled code takes a while to load
            from twin.robot.assembly.isolated_drive import IsolatedDrives

            # made here because a limit is given; otherwise `assemble` decides
            makers = IsolatedDrives(reporter, limit_step)
        with makers as maker:
            return execute(experiment, folder, reporter.progress, timed=True, maker=maker, **execution)
    except JobFailure as failure:
        raise ComponentFailed(f"{failure}\n{recording_status(folder)}") from None
    except InputRefused:
        if not out:
            discard_run_folder(folder)
        raise


def run_facts(experiment: Experiment, run: Run, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """Return the note on a completed run: the fields of `twin.robot.run.Run`, and remarks, `remarks` first."""
    return asdict(run) | {
        "recording": str(run.recording),
        "real_time_factor": run.real_time_factor,
        "robot_values": robot_values(experiment.values, experiment.origins),
        "remarks": [
            *remarks,
            *experiment.remarks,
            *([run.punctuality.sentence] if run.punctuality else []),
            *(["changed while it ran: the experiment's file alone does not repeat it"] if run.changed else []),
        ],
    }


def load_continuation(run: str, settings: Sequence[str]) -> tuple[Experiment, StoredState | None, str]:
    """Load an incomplete run's experiment, the state to continue from (None to run from the start), and a remark.

    Args:
        run: a recording or its folder, optionally with @ and the latest time (s) of the state.
        settings: empty, or "duration_s=...".
    """
    path, time = split_time(run)
    recording = recording_in(Path(path))
    metadata, duration = read_metadata(recording), _other_duration(settings)
    before = recorded_experiment(metadata, recording, changed=True)
    experiment = before if duration is None else recorded_experiment(metadata, recording, duration, changed=True)
    state, end = stored_state(recording, time), before.duration_ticks * before.cosim.tick
    if experiment.duration_ticks != before.duration_ticks:
        # FMUs know the end of the run, and may have used it
        return experiment, None, f"run again from the start: its FMUs know that it ends at {end:g} s"
    if state is None:
        when = "" if time is None else f" at {time:g} s or before"
        return experiment, None, f"run again from the start: {recording.name} has no state{when}"
    if state.time >= end - 0.5 * before.cosim.tick:
        raise InputRefused(
            f"--from {run}: it ended at {end:g} s, nothing is left to run; for a later end add --set "
            f"duration_s=..., for another part of it name the time of an earlier state, {path}@{0.5 * end:g}"
        )
    refuse_other_run(state.saved_state, machine_identity(versions()), str(recording))
    return experiment, state, f"continues from the state at {state.time:g} s of {recording.parent.name}"


def _other_duration(settings: Sequence[str]) -> float | None:
    duration = None
    for setting in settings:
        key, _, text = setting.partition("=")
        duration = parse_float(text)
        if key.strip() != "duration_s" or duration is None:
            raise InputRefused(
                f"--set {setting}: with --from only duration_s can be another one; twin branch changes more"
            )
    return duration


def served_runs(reporter: Reporter, port: int, origins: list[str], **arguments: Any) -> None:
    """Run and record experiments, served to live viewers; each run begins with its first viewer.

    Notes: as `recorded_runs`, and {"line": text of the server for the user}. `LiveServer` documents `port` and
    `origins`, `recorded_runs` the other arguments.

    Raises:
        InputRefused: websockets is not installed, the port is taken, or an origin is invalid.
    """
    with live_server(lambda text: reporter.note(line=text), port, origins) as server:
        recorded_runs(reporter, **arguments, viewer=server)


def live_server(say: Callable[[str], None], port: int, origins: Sequence[str], waits: bool = True) -> "LiveServer":
    """Create the server that shows runs to live viewers, see `LiveServer`."""
    try:
        from twin.robot.live.server import LiveServer
    except ImportError as missing:
        if not (missing.name or "").startswith("websockets"):
            raise
        raise InputRefused("--live: websockets is not installed; pip install 'websockets>=14'") from None
    return LiveServer(port, say, origins, waits)
