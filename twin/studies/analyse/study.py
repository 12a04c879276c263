"""`twin analyse`: linear stability analysis of an experiment's loops, or passivity of the robot in a hand."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.studies.command import BodyName, DriveName, ExperimentName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

if TYPE_CHECKING:
    from twin.robot.experiment.experiment import Experiment

RESULTS_FOLDER = Path("results") / "analysis"
FACTS_FILE, PICTURE_FILE, DISKS_FILE, MAP_FILE = "analysis.json", "analysis.png", "disks.png", "map.png"
PASSIVITY_FACTS, PASSIVITY_PICTURE = "passivity.json", "passivity.png"


@study(draws=True, isolated=True, before=[load_experiments])
def analyse(
    experiment: ExperimentName,
    say: Say,
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/analysis/EXPERIMENT.", "DIR")] = None,
    tried: Annotated[
        bool,
        Option(
            "Check the gain limits in the co-simulation, and search there for limits that do not hold.",
            flags="--try/--no-try",
        ),
    ] = True,
    passivity: Annotated[
        bool, Option("Analyse the impedance felt by a hand instead: passivity, rendered stiffness.")
    ] = False,
) -> Result:
    """Analyse the stability of the loops: margins, gain limits, damping, pictures.

    Drives are identified through their FMUs; the rest is linearised at rest,
    in free air and pressing, and sampled as the co-simulation samples it. The
    gain limits are then checked in the co-simulation. Exit code: 0 stable at
    every operating point, 1 unstable at one, 2 input refused or no linear
    model, 3 a drive failed, crashed or hung.

    Example: twin analyse experiments/fig4_force_position.toml
    """
    from twin.kernel.atomic_write import make_folder, write_json
    from twin.robot.assembly.load import load_experiment

    folder = make_folder(out or RESULTS_FOLDER / experiment.stem)
    loaded = load_experiment(experiment, settings, drive, body)
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    result = (_passivity if passivity else _stability)(loaded, tried, folder, home, say)
    write_json(home / (PASSIVITY_FACTS if passivity else FACTS_FILE), result.facts)
    return result


def _stability(experiment: "Experiment", tried: bool, folder: Path, home: Path, say: Say) -> Result:
    from twin.studies.analyse.pictures import draw_analysis, draw_disks, draw_stability_maps
    from twin.studies.analyse.stability import stability
    from twin.studies.analyse.text import analysis_result

    done = stability(experiment, tried, say)
    draw_analysis(done, home / PICTURE_FILE)
    files = [PICTURE_FILE]
    if any(point.disks for point in done.points):
        draw_disks(done, home / DISKS_FILE)
        files.append(DISKS_FILE)
    if done.maps:
        draw_stability_maps(done, home / MAP_FILE)
        files.append(MAP_FILE)
    return analysis_result(done, [str(folder / name) for name in (*files, FACTS_FILE)])


def _passivity(experiment: "Experiment", tried: bool, folder: Path, home: Path, say: Say) -> Result:
    from twin.studies.analyse.passivity import passivity
    from twin.studies.analyse.pictures import draw_passivity
    from twin.studies.analyse.text import passivity_result

    done = passivity(experiment, tried, say)
    draw_passivity(done, home / PASSIVITY_PICTURE)
    return passivity_result(done, [str(folder / name) for name in (PASSIVITY_PICTURE, PASSIVITY_FACTS)])
