"""An accuracy budget, from an experiment's file to facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.accuracy.budget import Budget, accuracy_budget
from twin.studies.accuracy.effects import NOT_MODELLED
from twin.studies.accuracy.text import accuracy_text
from twin.studies.answer import Answer
from twin.studies.steps import Say
from twin.writing import made_folder, write_json

HOME = Path("results") / "accuracy"
FACTS = "accuracy.json"


def budget(
    experiment: Path,
    settings: Sequence[str],
    drive: str | None,
    out: Path | None,
    say: Say,
) -> Answer:
    """The budget of the force error of an experiment, and its facts in `out`, or results/accuracy/EXPERIMENT.

    Args:
        experiment: its file or name.
        settings: see `load_experiment`.
        drive: see `load_experiment`.
        out: folder; None: results/accuracy/EXPERIMENT.
        say: told what is being run.

    Raises:
        InputRefused: the experiment, a drive or the folder cannot be used.
        ComponentFailed: a component failed.
    """
    loaded = load_experiment(experiment, settings, drive)
    folder = made_folder(out or HOME / loaded.name)
    found = accuracy_budget(loaded, say)
    facts = accuracy_facts(found)
    file = str(folder / FACTS)
    write_json(folder / FACTS, facts)
    return Answer(accuracy_text(found, file), facts | {"facts": file})


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
        "not_modelled": [{"label": what, "at_most_N": most, "meaning": why} for what, most, why in NOT_MODELLED],
        "bias_N": budget.bias,
        "together_N": budget.together,
        "parameters_N": budget.parameters,
    }  # fmt: skip
