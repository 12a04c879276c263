"""`twin accuracy`: the contribution of each imperfection to the force error, in newtons."""

from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, DriveName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "accuracy"
FACTS_FILE = "accuracy.json"


@study(isolated=True, before=[load_experiments])
def accuracy(
    experiment: Annotated[Path, Argument("Experiment that presses (TOML).", "EXPERIMENT", complete="experiment")],
    say: Say,
    drive: DriveName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/accuracy/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Budget of the force error: encoders, backlash, statics, coupling, parameters.

    Runs the experiment without any imperfection and with each of them alone,
    and reports in newtons how much each adds to the error of the estimated force.
    Exit code: 0 done, 2 input refused, 3 a drive failed.

    Example: twin accuracy experiments/fig4_force_position.toml
    """
    from twin.kernel.atomic_write import make_folder, write_json
    from twin.robot.assembly.load import load_experiment
    from twin.studies.accuracy.budget import accuracy_budget, accuracy_facts, accuracy_result

    loaded = load_experiment(experiment, settings, drive)
    folder = make_folder(out or RESULTS_FOLDER / loaded.name)
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    found = accuracy_budget(loaded, say)
    write_json(home / FACTS_FILE, accuracy_facts(found))
    return accuracy_result(found, str(folder / FACTS_FILE))
