"""A study of the coupling, from an experiment's file to files: picture, facts."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.answer import Answer
from twin.studies.converge.convergence import CouplingSeries, Study, convergence
from twin.studies.converge.picture import draw_convergence
from twin.studies.converge.text import convergence_text
from twin.studies.steps import Say
from twin.writing import finite, made_folder, write_json

HOME = Path("results") / "converge"
PICTURE, FACTS = "convergence.png", "convergence.json"


def converge(
    experiment: Path,
    settings: Sequence[str],
    drive: str | None,
    tolerance: float,
    duration: float | None,
    smooth: bool,
    out: Path | None,
    say: Say,
) -> Answer:
    """What the coupling of an experiment costs, and files in `out`, or results/converge/EXPERIMENT.

    Exit code 1: something is pressed, and no coupling meets the tolerance.

    Args:
        experiment: its file or name.
        settings: see `load_experiment`.
        drive: see `load_experiment`.
        tolerance: see `convergence`.
        duration: see `convergence`.
        smooth: see `convergence`.
        out: folder; None: results/converge/EXPERIMENT.
        say: told what is being run.

    Raises:
        InputRefused: the experiment, a drive or the folder cannot be used.
        ComponentFailed: a component failed in the experiment as it is.
    """
    loaded = load_experiment(experiment, settings, drive)
    folder = made_folder(out or HOME / loaded.name)
    done = convergence(loaded, tolerance, duration, smooth, say)
    files = {"picture": str(folder / PICTURE), "facts": str(folder / FACTS)}
    facts = convergence_facts(done)
    draw_convergence(done, folder / PICTURE)
    write_json(folder / FACTS, facts)
    met = done.choice is not None or not done.reference.pressed
    return Answer(convergence_text(done, files), facts | files, 0 if met else 1)


def convergence_facts(study: Study) -> dict[str, object]:
    """Everything that a study says in numbers, SI; what does not exist is None."""
    choice = study.choice
    return {
        "experiment": study.name,
        "duration_s": study.duration,
        "tick_s": study.tick,
        "coupling": asdict(study.coupling),
        "changes": list(study.changes),
        "reference": study.reference.meaning,
        "floor": study.reference.floor,
        "tolerance_N": study.tolerance,
        "recommended": choice
        and {"coupling": asdict(choice.coupling), "tick_s": choice.point.tick, "error_N": choice.point.errors["F_z"]},
        "series": [finite(_series_facts(one)) for one in study.series],
        "left_out": dict(study.left_out),
    }


def _series_facts(one: CouplingSeries) -> dict[str, object]:
    return {
        "coupling": asdict(one.coupling),
        "points": [
            {
                "tick_s": point.tick,
                "cost_s_per_s": point.cost,
                "largest_error": point.errors,
            }
            for point in one.points
        ],
        "order": {name: {"slope": order.slope, "finding": order.finding.value} for name, order in one.orders.items()},
        "power": [
            {
                "mean_W": joint.mean, "peak_W": joint.peak, "created_J": joint.energy,
                "throughput_J": joint.throughput,
            }
            for joint in one.residuals
        ],
    }  # fmt: skip
