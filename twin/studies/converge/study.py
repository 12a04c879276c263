"""`twin converge`: the cost of the coupling of drives and plant."""

from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, DriveName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "converge"
PICTURE_FILE, FACTS_FILE = "convergence.png", "convergence.json"


@study(draws=True, isolated=True, before=[load_experiments])
def converge(
    experiment: Annotated[Path, Argument("Experiment with a reference (TOML).", "EXPERIMENT", complete="experiment")],
    say: Say,
    drive: DriveName = None,
    settings: Settings = (),
    tolerance: Annotated[float, Option("Allowed error of the pressing force.", "N", least=0.0)] = 0.005,
    duration: Annotated[float | None, Option("Simulate only the first S seconds.", "S", least=0.01)] = None,
    smooth: Annotated[bool, Option("Leave out backlash and friction, for clean orders.")] = False,
    out: Annotated[Path | None, Option("Folder; default: results/converge/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Halve the step: error, order and power residual of each coupling.

    Runs the experiment in each scheme with held and interpolated inputs at
    several ticks, compares with a reference, and names the longest tick and the
    simplest coupling that keep the force within the tolerance.
    Exit code: 0 done, 1 no coupling does, 2 input refused, 3 a drive failed.

    Example: twin converge experiments/fig4_force_position.toml --duration 6
    """
    from twin.kernel.atomic_write import make_folder, write_json
    from twin.kernel.serialise import to_dict
    from twin.robot.assembly.load import load_experiment
    from twin.studies.converge.convergence import convergence
    from twin.studies.converge.picture import draw_convergence
    from twin.studies.converge.text import convergence_result

    loaded = load_experiment(experiment, settings, drive)
    folder = make_folder(out or RESULTS_FOLDER / loaded.name)
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    done = convergence(loaded, tolerance, duration, smooth, say)
    draw_convergence(done, home / PICTURE_FILE)
    write_json(home / FACTS_FILE, to_dict(done))
    return convergence_result(done, {"picture": str(folder / PICTURE_FILE), "facts": str(folder / FACTS_FILE)})
