"""A study of the coupling from file to files: picture, facts; and its text."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.converge.order import Order
from twin.studies.converge.picture import draw_convergence
from twin.studies.converge.signals import SIGNALS
from twin.studies.converge.study import Series, Study, convergence
from twin.studies.converge.text import convergence_text
from twin.writing import made_folder, write_json

HOME = Path("results") / "converge"
PICTURE, FACTS = "convergence.png", "convergence.json"


@dataclass(frozen=True)
class Request:
    """What a user asks of a study.

    Attributes:
        experiment, settings, drive: as of `load_experiment`.
        tolerance, duration, smooth: see `convergence`.
        out: the folder to write into; None: results/converge/EXPERIMENT.
    """

    experiment: Path
    settings: Sequence[str] = ()
    drive: str | None = None
    tolerance: float = 0.005
    duration: float | None = None
    smooth: bool = False
    out: Path | None = None


@dataclass(frozen=True)
class Report:
    """What comes of it. text: at most 80 columns; facts: for programs; found: False: no coupling met the tolerance."""

    text: str
    facts: dict[str, object]
    found: bool


def convergence_report(request: Request, say: Callable[[str], None] = lambda what: None) -> Report:
    """Run the study, and write picture and facts; `say` is told what is being run.

    Raises:
        InputRefused: the experiment, a drive or the folder cannot be used.
        ComponentFailed: a component failed in the experiment as it is.
    """
    experiment = load_experiment(request.experiment, request.settings, request.drive)
    folder = made_folder(request.out or HOME / experiment.name)
    study = convergence(experiment, request.tolerance, request.duration, request.smooth, say)
    files = {"picture": str(folder / PICTURE), "facts": str(folder / FACTS)}
    facts = convergence_facts(study)
    draw_convergence(study, folder / PICTURE)
    write_json(folder / FACTS, facts)
    return Report(
        convergence_text(study, files), facts | files, study.choice is not None or not study.reference.pressed
    )


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
        "series": [_series_facts(one) for one in study.series],
        "left_out": dict(study.left_out),
    }


def _series_facts(one: Series) -> dict[str, object]:
    return {
        "coupling": asdict(one.coupling),
        "points": [
            {
                "tick_s": point.tick,
                "cost_s_per_s": _finite(point.cost),
                "largest_error": {name: _finite(error) for name, error in point.errors.items()},
            }
            for point in one.points
        ],
        "order": {signal.name: _order_facts(one.orders[signal.name]) for signal in SIGNALS},
        "power": [
            {
                "mean_W": joint.mean, "peak_W": joint.peak, "created_J": joint.energy,
                "throughput_J": joint.throughput,
            }
            for joint in one.residuals
        ],
    }  # fmt: skip


def _order_facts(order: Order) -> dict[str, object]:
    return {"slope": order.slope, "finding": order.finding.value}


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
