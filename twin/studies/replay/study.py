"""`twin replay`: a robot's log through the twin."""

import shlex
from pathlib import Path
from typing import Annotated

from twin.studies.command import (
    Argument,
    ArgumentValues,
    ColumnMaps,
    FromS,
    Option,
    Say,
    Settings,
    Steps,
    ToS,
    ignore_progress,
    study,
)
from twin.studies.precheck import find_experiments, find_logs, print_latest
from twin.studies.result import Result

REPLAY_FOLDER = Path("results") / "replay"
PICTURE_FILE, FACTS_FILE = "replay.png", "replay.json"


def _check_baseline(asked: ArgumentValues) -> None:
    from twin.studies.replay.replay import normal_time

    normal_time(asked["baseline"])


@study(draws=True, before=[find_logs, find_experiments, _check_baseline, print_latest])
def replay(
    log: Annotated[Path, Argument("A CSV or MCAP file of a robot, or a run of twin.", "LOG")],
    experiment: Annotated[
        Path | None, Option("Experiment that describes the robot; without it, that of the run.", "FILE")
    ] = None,
    maps: ColumnMaps = (),
    settings: Settings = (),
    plant: Annotated[bool, Option("Also simulate the plant, driven by the log's motor angles.")] = False,
    baseline: Annotated[
        str, Option("Reference part of the log, best in free air: first S seconds, or FROM:TO.", "S")
    ] = "1",
    tolerance: Annotated[
        float | None, Option("Force change that does not count; default: the effect of rounding.", "N")
    ] = None,
    from_s: FromS = None,
    to_s: ToS = None,
    out: Annotated[Path | None, Option("Folder; default: results/replay/NAME/TIME.", "DIR")] = None,
    say: Say = ignore_progress,
) -> Result:
    """Replay a robot's log: position, force, and whether the twin still matches.

    The log has encoder counts (encoder.count_m[0..2], encoder.count_l[0..2])
    or angles (estimator.theta_m[0..2], estimator.theta_l[0..2]), and may have
    a measured force (scale.F_z, pressing positive). Exit code: 0 done, 1 robot
    and twin diverge, 2 input refused, 3 the plant model left the workspace.

    Example: twin replay results/fig4_force_position --plant
    """
    from twin.kernel.atomic_write import write_json
    from twin.kernel.recording.folder import RECORDING_FILE, new_run_folder
    from twin.kernel.recording.logs.column_map import column_map
    from twin.kernel.recording.logs.reader import read_log
    from twin.studies.replay.held import log_measures
    from twin.studies.replay.model import model_for
    from twin.studies.replay.recording import record
    from twin.studies.replay.replay import normal_time, replay_log
    from twin.studies.replay.text import draw_replay, next_command, replay_facts, replay_result

    steps = Steps(say, 3)
    steps.next("reading")
    curves = read_log(log, column_map(maps), (from_s, to_s))
    model = model_for(curves.path, experiment, settings)
    steps.next("estimating, and the plant model" if plant else "estimating")
    done = replay_log(curves, model, plant, normal_time(baseline), tolerance)
    held = log_measures(done.log, done.estimator, experiment, tuple(settings))
    name = model.name if experiment is None else curves.path.stem
    folder = new_run_folder(out, REPLAY_FOLDER, name)
    files = {"recording": folder / RECORDING_FILE, "picture": folder / PICTURE_FILE, "facts": folder / FACTS_FILE}
    steps.next("recording and drawing")
    record(done, files["recording"])
    draw_replay(done, name, files["picture"])
    write_json(files["facts"], replay_facts(done, held))
    options = {"--experiment": [experiment] if experiment else [], "--map": maps, "--set": settings}
    options |= {"--from-s": [] if from_s is None else [from_s], "--to-s": [] if to_s is None else [to_s]}
    words = [word for option, values in options.items() for value in values for word in (option, str(value))]
    first = next_command(done, str(log))
    following = shlex.join([*first, *words]) if first else ""
    return replay_result(done, held, name, {kind: str(path) for kind, path in files.items()}, following)
