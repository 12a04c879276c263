"""An analysis, from an experiment's file to files: pictures, facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.analyse.disk_picture import draw_disks
from twin.studies.analyse.map import draw_stability_maps
from twin.studies.analyse.picture import draw_analysis
from twin.studies.analyse.stability import stability
from twin.studies.analyse.text import analysis_text
from twin.studies.answer import Answer
from twin.studies.steps import Say
from twin.writing import made_folder, write_json

HOME = Path("results") / "analysis"
FACTS, PICTURE, DISKS, MAP = "analysis.json", "analysis.png", "disks.png", "map.png"


def analyse(
    experiment: Path,
    drive: str | None,
    body: str | None,
    settings: Sequence[str],
    tried: bool,
    out: Path | None,
    say: Say,
) -> Answer:
    """How stable the loops of an experiment are, and files in `out`, or results/analysis/EXPERIMENT.

    Exit code 1: they are unstable at an operating point.

    Args:
        experiment: its file or name.
        drive: see `load_experiment`.
        body: see `load_experiment`.
        settings: see `load_experiment`.
        tried: whether gain limits are tried in the co-simulation.
        out: folder; None: results/analysis/EXPERIMENT.
        say: told what is being done.

    Raises:
        InputRefused, ComponentFailed: see `stability`; or the folder cannot be used.
    """
    folder = made_folder(out or HOME / experiment.stem)
    done = stability(load_experiment(experiment, settings, drive, body), tried, say)
    draw_analysis(done, folder / PICTURE)
    pictures = [PICTURE]
    if any(point.disks for point in done.points):
        draw_disks(done, folder / DISKS)
        pictures.append(DISKS)
    if done.maps:
        draw_stability_maps(done, folder / MAP)
        pictures.append(MAP)
    files = [str(folder / name) for name in (*pictures, FACTS)]
    facts = done.facts() | {"files": files}
    write_json(folder / FACTS, facts)
    text = "\n".join([analysis_text(done), "", *(f"  {file}" for file in files)])
    return Answer(text, facts, 0 if done.stable else 1)
