"""`twin identify`: springs, zeros, backlash and scale from a calibration."""

from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, ColumnMaps, FromS, Option, Say, Settings, ToS, ignore_progress, study
from twin.studies.precheck import find_experiments, find_logs, print_latest
from twin.studies.result import Result

IDENTIFY_FOLDER = Path("results") / "identify"
PICTURE_FILE, MODEL_FILE, FACTS_FILE = "identify.png", "model.toml", "identify.json"


@study(draws=True, before=[find_logs, find_experiments, print_latest])
def identify(
    log: Annotated[Path, Argument("A run of twin, or a CSV or MCAP file of a robot.", "LOG")],
    experiment: Annotated[
        Path | None, Option("Experiment that describes the robot; without it, that of the run.", "FILE")
    ] = None,
    maps: ColumnMaps = (),
    settings: Settings = (),
    height: Annotated[float | None, Option("Measured height of a level scale, for the encoder zeros.", "MM")] = None,
    motor_torque: Annotated[bool, Option("Use the measured drive/n.tau_motor to separate k_s from eta.")] = False,
    paper: Annotated[bool, Option("Also print the result of the paper's own procedure, Sec. III.A.")] = False,
    from_s: FromS = None,
    to_s: ToS = None,
    out: Annotated[Path | None, Option("Folder; default: results/identify/NAME/TIME.", "DIR")] = None,
    say: Say = ignore_progress,
) -> Result:
    """Identify a robot from presses on a scale: k_s eta, zeros, backlash, friction.

    Each number has its 95 % interval; quantities that the log cannot determine
    are named. The log has encoders (as for twin replay) and scale.F_z, pressing
    positive. See docs/identification.md. Exit code: 0 done, 1 k_s eta cannot be
    determined from this log, 2 input refused.

    Example: twin identify results/fig4_force_position
    """
    from twin.kernel.atomic_write import write_json, write_text
    from twin.kernel.recording.folder import new_run_folder
    from twin.kernel.recording.logs.column_map import column_map
    from twin.kernel.recording.logs.reader import is_recording, read_log
    from twin.studies.identify.identification import identify_log
    from twin.studies.identify.text import (
        draw_identification,
        identification_facts,
        identification_result,
        model_fragment,
        truth,
    )
    from twin.studies.replay.model import model_for

    say("reading", 0.0)
    curves = read_log(log, column_map(maps), (from_s, to_s))
    model, own = model_for(curves.path, experiment, settings), is_recording(curves.path)
    one = identify_log(curves, model, None if height is None else 1e-3 * height, motor_torque, say)
    # the truth is known only for a run of the twin with its own experiment
    true = truth(model) if own and experiment is None else {}
    name = model.name if own else curves.path.stem
    folder = new_run_folder(out, IDENTIFY_FOLDER, name)
    files = {"model": folder / MODEL_FILE, "picture": folder / PICTURE_FILE, "facts": folder / FACTS_FILE}
    draw_identification(one, name, files["picture"])
    write_text(files["model"], model_fragment(one, curves.path.name))
    facts = identification_facts(one, curves.path.name, true)
    write_json(files["facts"], facts)
    named = {kind: str(path) for kind, path in files.items()}
    return identification_result(one, name, named, true, facts, paper)
