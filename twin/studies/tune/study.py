"""`twin tune`: gains for given goals."""

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from twin.studies.command import BodyName, ExperimentName, Option, Say, Settings, study
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

TUNING_FOLDER = Path("results") / "tuning"
NO_SCHEDULE = "controller.force.schedule=[]"
FACTS_FILE, PICTURE_FILE, GAINS_FILE = "tuning.json", "tuning.png", "tuned.toml"


@study(draws=True, isolated=True, before=[load_experiments])
def tune(
    experiment: ExperimentName,
    say: Say,
    margin: Annotated[float, Option("Largest |1/(1+L)| of any loop.", "M_S")] = 1.6,
    overshoot: Annotated[
        float, Option("Largest overshoot of a step, and at touch-down.", "PERCENT", "--overshoot-percent")
    ] = 5.0,
    bandwidth: Annotated[
        float | None, Option("Lowest bandwidth, of the force if it is controlled.", "HZ", "--bandwidth-Hz")
    ] = None,
    stiffness: Annotated[
        str | None, Option("Range of the body's stiffness.", "LOW:HIGH", "--stiffness-N-per-m")
    ] = None,
    schedule: Annotated[bool, Option("Also schedule gains over stiffness; default range 300:5000.")] = False,
    drives: Annotated[Sequence[str], Option("A drive the gains have to fit; may be repeated.", "FMU", "--drive")] = (),
    body: BodyName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/tuning/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Find the fastest gains that keep a margin and an overshoot everywhere.

    The search uses the linear model at every place, stiffness and drive, and
    simulates the experiment with gains that the model finds best: it has to
    overshoot no more, to settle, and to hold its force no worse than before.
    The experiment's file is not changed: tuned.toml extends it.

    Exit code: 0 goals met and confirmed, 1 they are not (the best found is
    shown), 2 input refused or no linear model, 3 a drive failed, crashed or
    hung.

    Example: twin tune experiments/fig4_force_position.toml
    """
    from twin.kernel.atomic_write import make_folder, write_json, write_text
    from twin.robot.assembly.load import load_experiment
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.tune.prediction import Goals, stiffness_range
    from twin.studies.tune.schedule import STIFFNESS_RANGE, design_schedule, schedule_lines, schedule_parts
    from twin.studies.tune.text import draw_tuning, fragment, tuning_parts
    from twin.studies.tune.tuned import tune_gains

    goals = Goals(margin, overshoot / 100.0, None if bandwidth is None else 2.0 * math.pi * bandwidth)
    folder = make_folder(out or TUNING_FOLDER / experiment.stem)
    # Absolute, because an FMU may change the working directory.
    home = folder.absolute()
    file = experiment_file(experiment)
    span = None if stiffness is None else stiffness_range(stiffness)
    # With several drives, the experiment in tuned.toml keeps the drive of the file.
    one = [("--drive", drives[0])] if len(drives) == 1 else []
    given = [*one, ("--body", body), *(("--set", setting) for setting in settings)]
    options = [word for option, value in given if value is not None for word in (option, value)]
    if schedule:
        span = span or STIFFNESS_RANGE
        # The one set is tuned first and becomes the safe set.
        settings = [*settings, NO_SCHEDULE]
    models = [load_experiment(file, settings, drive, body) for drive in dict.fromkeys(drives or (None,))]
    done = tune_gains(models, goals, span, say)
    if schedule:
        say("designing the schedule")
    over = design_schedule(done) if schedule else None
    files = [str(folder / name) for name in (GAINS_FILE, PICTURE_FILE, FACTS_FILE)]
    again = shlex.join(["twin", "run", str(folder / GAINS_FILE), *options])
    facts = done.to_dict() | {"files": files, "again": again}
    lines, (first, *parts) = fragment(done, file, folder, options), tuning_parts(done)
    if over is not None:
        lines += schedule_lines(over, done.experiments[0].controller.tissue is not None)
        parts += ["", *schedule_parts(over), ""]
        facts["schedule"] = over.to_dict()
    write_text(home / GAINS_FILE, lines)
    draw_tuning(done, home / PICTURE_FILE)
    write_json(home / FACTS_FILE, facts)
    met = done.meets_goals and (over is None or over.meets_goals)
    shown = {file: file for file in files}
    return Result(first, [*parts, f"next  {again}", ""], facts, shown, label=0, exit_code=0 if met else 1)
