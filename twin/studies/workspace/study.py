"""`twin robot`: capability of a robot on one page, with a picture."""

from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, DriveName, Option, Say, Settings, study
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "robot"


@study(draws=True, isolated=True)
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
    # absolute: an FMU may change the working directory
    folder = make_folder(out or RESULTS_FOLDER / loaded.name)
    files = {kind: (folder / name).absolute() for kind, name in (("picture", "robot.png"), ("facts", "robot.json"))}
    done = capability(loaded, rank, say)
    draw_capability(done, loaded, files["picture"])
    result = capability_result(done, {kind: str(folder / file.name) for kind, file in files.items()})
    write_json(files["facts"], result.facts)
    return result
