"""How passive a robot is in the hand, from an experiment's file to files: picture, facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.analyse.passivity import passivity
from twin.studies.analyse.passivity_picture import draw_passivity
from twin.studies.analyse.passivity_text import passivity_text
from twin.studies.analyse.study import HOME
from twin.studies.answer import Answer
from twin.studies.steps import Say
from twin.writing import made_folder, write_json

FACTS, PICTURE = "passivity.json", "passivity.png"


def in_the_hand(
    experiment: Path,
    drive: str | None,
    body: str | None,
    settings: Sequence[str],
    tried: bool,
    out: Path | None,
    say: Say,
) -> Answer:
    """What a hand feels of an experiment's robot, and files in `out`, or results/analysis/EXPERIMENT.

    Exit code 1: it is unstable in an empty hand.

    Args:
        experiment: its file or name.
        drive: see `load_experiment`.
        body: see `load_experiment`.
        settings: see `load_experiment`.
        tried: whether a prediction is tried in the co-simulation.
        out: folder; None: results/analysis/EXPERIMENT.
        say: told what is being done.

    Raises:
        InputRefused, ComponentFailed: see `passivity`; or the folder cannot be used.
    """
    folder = made_folder(out or HOME / experiment.stem)
    done = passivity(load_experiment(experiment, settings, drive, body), tried, say)
    draw_passivity(done, folder / PICTURE)
    files = [str(folder / name) for name in (PICTURE, FACTS)]
    facts = done.facts() | {"files": files}
    write_json(folder / FACTS, facts)
    text = "\n".join([passivity_text(done), "", *(f"  {file}" for file in files)])
    return Answer(text, facts, 0 if all(point.stable for point in done.points) else 1)
