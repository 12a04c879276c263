"""Commands that write new files: an experiment, its schema for editors, the column map of a robot's log."""

import contextlib
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from twin.studies.command import Answer, Argument, Option, study
from twin.studies.precheck import find_logs


@study(json=False)
def init(
    file: Annotated[Path | None, Argument("The experiment to write; default: experiment.toml.", "FILE")] = None,
    start: Annotated[
        str, Option("The experiment to start from.", "NAME", "--from", complete="experiment name")
    ] = "fig4_force_position",
    robot: Annotated[
        Path | None, Option("File of another robot: to use, or with --lengths-mm to write.", "ROBOT", "--robot")
    ] = None,
    lengths: Annotated[
        Sequence[str], Option("Lengths of a new robot, Fig. 2: a=80 b=35 l_a=100 l_b=180.", "a=MM", "--lengths-mm")
    ] = (),
    masses: Annotated[
        Sequence[str], Option("Masses of a new robot: m_a=40 m_b=30 m_p=100.", "m_a=G", "--masses-g")
    ] = (),
    settings: Annotated[
        Sequence[str], Option("Other value of a new robot: robot.k_s_Nm_per_rad=2.", "KEY=VALUE", "--set")
    ] = (),
) -> Answer:
    """Write an experiment to start from, with every key, its meaning, unit and default.

    It runs unchanged from any folder. The JSON Schema for editors is written
    next to it if missing. With --robot the experiment moves to another robot,
    whose file --lengths-mm writes first; masses and springs that are not given
    come from the shipped robot. No file is overwritten.

    Exit code: 0 written, 2 refused.

    Example: twin init my_experiment.toml --from pressing
    """
    from twin.kernel.errors import InputRefused
    from twin.robot.assembly.declared import DECLARED_TABLES
    from twin.robot.assembly.own_robot import experiment_on_robot, robot_notes, start_on_robot, start_robot
    from twin.robot.experiment.template import start_experiment

    if (lengths or masses or settings) and not (robot and lengths):
        raise InputRefused(
            "--lengths-mm, --masses-g and --set describe a new robot; expected --robot my_robot.toml --lengths-mm a=80 "
            "b=35 l_a=100 l_b=180"
        )
    if file and robot and lengths and (os.path.lexists(file) or file == robot):
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name")
    new = start_robot(robot, lengths, masses, settings) if robot and lengths else []
    notes: list[str] = []
    if robot and new and file is None:
        with contextlib.suppress(InputRefused):
            # a new robot that cannot do the experiment
            notes = robot_notes(experiment_on_robot(robot, start))
        press = shlex.join(["twin", "init", "press.toml", "--robot", str(robot)])
        following = [shlex.join(["twin", "robot", str(robot)]), press, "twin run press.toml"]
    else:
        file = file or Path("experiment.toml")
        if robot:
            added, experiment = start_on_robot(file, start, robot)
            new, notes = new + added, robot_notes(experiment)
        else:
            new = start_experiment(DECLARED_TABLES, file, start)
        following = [shlex.join(["twin", "run", str(file)])]
    written = [str(path) for path in new]
    lines = [*written, *(f"note: {note}" for note in notes), *(f"next: {words}" for words in following)]
    return Answer("\n".join(lines), written)


@study(json=False)
def schema(
    out: Annotated[Path | None, Option("Write to this file instead of printing.", "FILE")] = None,
) -> Answer:
    """Print the JSON Schema of the experiment file, for editors.

    An editor that knows TOML schemas (Even Better TOML, taplo) completes and
    checks a file that begins with the line `#:schema experiment.schema.json`.

    Exit code: 0 done, 3 it cannot be written.

    Example: twin schema --out experiment.schema.json
    """

    from twin.robot.assembly.declared import DECLARED_TABLES
    from twin.robot.experiment.json_schema import schema_text

    text = schema_text(DECLARED_TABLES)
    if out is None:
        return Answer(text.removesuffix("\n"), {})
    from twin.kernel.atomic_write import write_text

    write_text(out, text)
    return Answer(str(out), {})


@study("drive copy", json=False)
def drive_copy(
    name: Annotated[str, Argument("A drive of fmus/.", "NAME", complete="drive")],
    folder: Annotated[Path, Argument("The folder to create.", "FOLDER")],
) -> Answer:
    """Copy a drive that comes with twin, with its FMU, mapping and sources.

    Exit code: 0 copied, 2 no such drive, or the folder exists.

    Example: twin drive copy pmsm_foc my_drive
    """
    import shutil

    from twin.kernel.atomic_write import make_folder
    from twin.kernel.errors import InputRefused, NotWritten, nearest, translate_disk_errors
    from twin.robot.experiment.experiment_files import drive_names
    from twin.robot.paths import locate_file

    shelf = locate_file("fmus", Path.cwd())
    known = drive_names(shelf)
    if name not in known:
        raise InputRefused(f"{name}: no such drive in {shelf}; {nearest(name, known)}")
    if os.path.lexists(folder):
        raise InputRefused(f"{folder}: exists; name a new folder")
    make_folder(folder.absolute().parent)
    with translate_disk_errors(folder, kind=NotWritten):
        shutil.copytree(shelf / name, folder)
    files = [str(path) for path in sorted(folder.rglob("*")) if path.is_file()]
    fmus = [file for file in files if file.endswith(".fmu") and str(folder / "mapping.toml") not in files]
    following = shlex.join(["twin", "drive", "info", *(fmus or [str(folder)])[:1]])
    return Answer("\n".join([*files, f"next: {following}"]), files)


@study("log new", json=False, before=[find_logs])
def log_new(log: Annotated[Path, Argument("A CSV file of a robot.", "CSV")]) -> Answer:
    """Write a column map for a robot's CSV file, next to it.

    Names, units and values decide which columns are the time, the encoders of
    motors and joints, and the measured force. Doubtful lines are comments. An
    existing map is never changed.

    Exit code: 0 written, 2 refused.

    Example: twin log new robot.csv
    """
    from twin.studies.replay.map_proposal import propose

    path, complete = propose(log)
    words = ["twin", "replay", str(log), "--experiment", "fig4_force_position", "--map", str(path)]
    standing = "complete" if complete else "NOT complete: remove the # from the right lines"
    text = f"{path}\n{standing}\nthen, with the experiment that describes the robot: {shlex.join(words)}"
    return Answer(text, {"map": str(path), "complete": complete})
