"""`twin robot`: capability of a robot on one page, with a picture."""

from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, DriveName, Option, Say, Settings, study
from twin.studies.precheck import load_robot_or_experiment
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "robot"
FACTS_FILE, PICTURE_FILE = "robot.json", "robot.png"


@study(draws=True, isolated=True, before=[load_robot_or_experiment])
def robot(
    experiment: Annotated[Path, Argument("File of a robot, or an experiment.", "ROBOT", complete="experiment")],
    say: Say,
    drive: DriveName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/robot/ROBOT.", "DIR")] = None,
    rank: Annotated[
        bool, Option("Rank the values by their effect on the force, which takes 30 runs.", flags="--rank/--no-rank")
    ] = True,
) -> Result:
    """Report the capability of a robot: reach, stiffness, forces, speeds, with a picture.

    Numbers hold for the platform on the axis at the height of the surface. The
    drive's torque and speed are measured through its FMU. A robot's own file
    runs as Fig. 4 at its height. Exit code: 0 done, 2 input refused, 3 a drive
    failed.

    Example: twin robot experiments/robots/massage_robot.toml
    """
    from twin.kernel.atomic_write import make_folder, write_json
    from twin.robot.assembly.own_robot import load_on_robot
    from twin.studies.workspace.capability import capability
    from twin.studies.workspace.text import capability_result, draw_capability

    loaded = load_on_robot(experiment, settings, drive)
    folder = make_folder(out or RESULTS_FOLDER / loaded.name)
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    done = capability(loaded, rank, say)
    draw_capability(done, loaded, home / PICTURE_FILE)
    result = capability_result(done, {"picture": str(folder / PICTURE_FILE), "facts": str(folder / FACTS_FILE)})
    write_json(home / FACTS_FILE, result.facts)
    return result
