"""`twin shadow`: the twin of a live robot, or of its log."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import terminal_text
from twin.studies.command import (
    DEFAULT_PORT,
    ArgumentValues,
    ColumnMaps,
    ExperimentName,
    FromS,
    LiveOrigins,
    LivePort,
    Option,
    Say,
    Settings,
    ToS,
    ignore_progress,
    study,
)
from twin.studies.precheck import find_experiments, print_latest
from twin.studies.result import Result

if TYPE_CHECKING:
    from twin.studies.shadow.alarm import RateTolerances

SHADOW_FOLDER = Path("results") / "shadow"
FACTS_FILE = "shadow.json"


def _find_source(asked: ArgumentValues) -> None:
    from twin.studies.shadow.sources import refuse_source

    refuse_source(asked["source"])


def _limits(
    fleet: Path | None, experiment: Path, settings: Sequence[str], say: Say
) -> "tuple[RateTolerances | None, str]":
    """Load or compute the alarm's tolerances for an experiment. Return them, or None, and the reason if missing."""
    from twin.kernel.errors import TwinError
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.shadow.fleet import read_fleet
    from twin.studies.shadow.tolerances import FLEET_FILE, tolerances_of

    try:
        robots = read_fleet(fleet or FLEET_FILE, experiment_file(experiment), settings=settings)
        return tolerances_of(robots, say)[0], ""
    except TwinError as problem:
        if fleet:
            raise
        return None, f"its healthy robots give no tolerances: {problem}"


def _print(text: str) -> None:
    """Print a message to standard error, over the status line of a terminal."""
    shown = terminal_text(text)
    print(f"\r{shown:79}" if sys.stderr.isatty() else shown, file=sys.stderr, flush=True)


@study(reported=True, before=[_find_source, find_experiments, print_latest])
def shadow(
    experiment: ExperimentName,
    source: Annotated[str, Option("ros2:/TOPIC or zenoh:/TOPIC of a live robot, or a log.", "SOURCE")],
    maps: ColumnMaps = (),
    settings: Settings = (),
    speed: Annotated[float, Option("Pace of a log: 1 is real time, 0 as fast as possible.", "N", least=0.0)] = 1.0,
    lateness_ms: Annotated[
        float, Option("Time to wait for a late message; later ones count as missing.", "MS", least=0.0)
    ] = 30.0,
    from_s: FromS = None,
    to_s: ToS = None,
    duration_s: Annotated[
        float | None, Option("End after this time by the robot's stamps; default: at the log's end, or by Ctrl-C.", "S")
    ] = None,
    fleet: Annotated[
        Path | None,
        Option("Healthy robots that the alarm's tolerances come from (a sweep file); default: the shipped.", "FILE"),
    ] = None,
    no_alarm: Annotated[bool, Option("Raise no alarm, and compute no tolerances.", flags="--no-alarm")] = False,
    false_alarms_per_hour: Annotated[float, Option("Accepted rate of false alarms.", "N")] = 0.01,
    adapt: Annotated[bool, Option("Accept the proposed change after an alarm, and continue with it.")] = False,
    what_if: Annotated[
        Sequence[str],
        Option(
            "Also predict with another value; several keys with ';'; may be repeated.",
            "KEY=VALUE",
            complete="setting",
        ),
    ] = (),
    force_limit_N: Annotated[
        float | None, Option("Warn of a predicted force beyond it; default: the monitor's limit.", "N", least=0.0)
    ] = None,
    live: Annotated[bool, Option("Serve twin and robot to Lichtblick or Foxglove.")] = False,
    port: LivePort = DEFAULT_PORT,
    origins: LiveOrigins = (),
    out: Annotated[Path | None, Option("Folder; default: results/shadow/EXPERIMENT/TIME.", "DIR")] = None,
    say: Say = ignore_progress,
) -> Result:
    """Follow a live robot: its state, and when robot and twin diverge.

    The twin receives the robot's encoders and never sends anything to it. It
    is stepped by the stamps of the messages. The recording has the robot's
    messages as they arrived, and the twin's topics. Every 0.5 s the twin
    predicts force and height of the next second, with a band. With a live
    robot it has real-time priority (SCHED_FIFO), where permitted. Domain of
    DDS and zenoh: ROS_DOMAIN_ID.

    The alarm's tolerances are shipped for the experiments of Fig. 4 and the
    tasks. With another drive, body or setting they are computed once, in some
    minutes, and cached.

    Exit code: 0 robot and twin match, or nothing was watched; 1 they diverge;
    2 input refused; 3 a component failed, or a file could not be written;
    70 internal error.

    Example: twin shadow fig4_force_position --source results/fig4_force_position --speed 0
    """
    from contextlib import ExitStack
    from datetime import datetime

    from twin.kernel.atomic_write import write_json
    from twin.kernel.errors import InputRefused
    from twin.kernel.recording.folder import RECORDING_FILE, claim_run_folder, create_run_folder
    from twin.kernel.recording.logs.column_map import column_map
    from twin.robot.assembly.load import load_experiment
    from twin.robot.live.runs import live_server
    from twin.studies.replay.model import model_of
    from twin.studies.shadow.ahead import changed_experiments, session_branches
    from twin.studies.shadow.command_comparison import comparison_of
    from twin.studies.shadow.deviations import DEAD_ZONE_KEY, NOT_IDENTIFIED, SPRING_KEY, is_identified
    from twin.studies.shadow.following import AlarmWatch, twin_of
    from twin.studies.shadow.live_view import ShadowViewer
    from twin.studies.shadow.mapping import wanted_signals
    from twin.studies.shadow.reidentification import Reidentifier
    from twin.studies.shadow.session import Session
    from twin.studies.shadow.sources import open_source
    from twin.studies.shadow.text import shadow_facts, shadow_result

    if no_alarm and (adapt or fleet):
        other = "--adapt" if adapt else "--fleet"
        raise InputRefused(f"{other}: needs the alarm; leave out --no-alarm")
    if duration_s is not None and not duration_s > 0.0:
        raise InputRefused(f"--duration-s {duration_s:g}: expected a time > 0 s")
    loaded = load_experiment(experiment, settings)
    model = model_of(loaded)
    wanted = wanted_signals(model.belief)
    changed = changed_experiments(experiment, settings, what_if)
    with ExitStack() as stack:
        notes: list[str] = []
        ahead = session_branches(loaded, changed, force_limit_N, notes.append)
        if ahead:
            stack.enter_context(ahead)
        robot, columns, of_now = open_source(
            source, column_map(maps), wanted, model.belief, speed, notes, (from_s, to_s)
        )
        stack.callback(robot.close)
        watched, why = None, "--no-alarm"
        identified = all(is_identified(loaded, key) for key in (SPRING_KEY, DEAD_ZONE_KEY))
        caution = "" if identified else NOT_IDENTIFIED
        if not no_alarm:
            limits, why = _limits(fleet, experiment, settings, say)
        if not why:
            assert limits is not None
            reidentifier = Reidentifier(loaded, wait=not of_now)
            watched = AlarmWatch(limits, false_alarms_per_hour, reidentifier, caution, comparison_of(loaded))
        beside, viewer = ahead.predicting_part if ahead else None, None
        twin = twin_of(loaded, model, robot.name, watched, adapt, beside, columns)
        if live:
            server = stack.enter_context(live_server(_print, port, origins, waits=False))
            viewer = ShadowViewer(server, twin.topics, loaded, twin)
        duration = math.inf if duration_s is None else duration_s
        messages = columns if robot.has_messages else {}
        session = Session(
            robot, messages, wanted, twin, model, 1e-3 * lateness_ms, duration, of_now, say, _print, viewer
        )
        if caution and (watched or ahead):
            notes.append(
                f"{caution}; until [plant] has an identified {SPRING_KEY[6:]} and {DEAD_ZONE_KEY[6:]}, "
                "the alarm's tolerances are wide, and no share is promised of the band"
            )
        session.followed.notes += notes
        session.followed.no_alarm, session.followed.caution = why, caution
        session.followed.ahead = ahead.score if ahead else None
        session.wait_for_topics()
        claimed = claim_run_folder(out) if out else None

        def recording() -> Path:
            return (claimed or create_run_folder(SHADOW_FOLDER, model.name, datetime.now())) / RECORDING_FILE

        followed = session.follow(recording)
    facts = followed.recording.parent / FACTS_FILE
    write_json(facts, shadow_facts(followed, model.name))
    return shadow_result(followed, model.name, {"recording": followed.recording, "facts": facts})
