"""An accuracy budget from file to file: facts, rows for a page, and text."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.accuracy.budget import Budget, accuracy_budget
from twin.studies.accuracy.text import accuracy_text
from twin.writing import made_folder, write_json

HOME = Path("results") / "accuracy"
FACTS = "accuracy.json"


@dataclass(frozen=True)
class Report:
    """What comes of it. text: at most 80 columns; facts: for programs."""

    text: str
    facts: dict[str, object]


def accuracy_report(
    experiment: Path,
    settings: Sequence[str] = (),
    drive: str | None = None,
    out: Path | None = None,
    say: Callable[[str], None] = lambda what: None,
) -> Report:
    """Make the budget of the experiment at a path, and write its facts into `out`, or results/accuracy/EXPERIMENT.

    `say` is told what is being run.

    Raises:
        InputRefused: the experiment, a drive or the folder cannot be used.
        ComponentFailed: a component failed.
    """
    loaded = load_experiment(experiment, settings, drive)
    folder = made_folder(out or HOME / loaded.name)
    budget = accuracy_budget(loaded, say)
    facts = accuracy_facts(budget)
    write_json(folder / FACTS, facts)
    return Report(accuracy_text(budget, str(folder / FACTS)), facts | {"facts": str(folder / FACTS)})


def accuracy_facts(budget: Budget) -> dict[str, object]:
    """Everything that a budget says, N and s: what `accuracy.json` holds."""
    return {
        "experiment": budget.name,
        "start_s": budget.start,
        "end_s": budget.end,
        "force_N": budget.force,
        "contributions": [
            {
                "label": one.label, "group": one.group, "bias_N": one.bias, "std_N": one.std, "rms_N": one.rms,
                "meaning": one.meaning,
            }
            for one in (*budget.contributions, budget.as_is)
        ],
        "bias_N": budget.bias,
        "together_N": budget.together,
        "parameters_N": budget.parameters,
    }  # fmt: skip
