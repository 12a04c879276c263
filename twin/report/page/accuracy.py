"""Where the error of a run's force comes from, in newtons, cause by cause."""

from collections.abc import Iterable, Sequence

from twin.report.page.markup import Markup, element, joined, table
from twin.studies.accuracy.budget import NOT_MODELLED, Budget, Contribution
from twin.studies.accuracy.text import NUMBERS, details, headline, row
from twin.studies.result import Cell, Column, Table

HEAD = tuple(f"{column.name}, N" for column in NUMBERS)
MEANING = "what it means"
WHY = "why so much, assumed"


def accuracy(budget: Budget, label: str) -> Markup:
    """The sentence, what is in the run, and what is not: the twin's own error and beliefs that may be off.

    Args:
        budget: of the run's experiment.
        label: of the run.
    """
    found, why = headline(budget), details(budget)
    together = ("all of them", budget.bias, None, budget.together, "sum of biases, root of squares")
    added = ("all of them", None, None, budget.parameters, "root of the sum of squares")
    causes = [*map(_row, budget.of("imperfection")), together, _row(budget.as_is)]
    beliefs = [*map(_row, budget.of("parameter")), added]
    others = f"None of this is in the run: each line is another, whose controller believes otherwise. {_begun(why[1])}."
    return joined(
        [
            element("p", f"{_begun(found)}. {_begun(why[0])}."),
            _table("cause", MEANING, causes, f"causes of the force error of {label}"),
            element("h3", "The twin itself"),
            _table("cause", MEANING, map(_row, budget.of("twin")), f"error of the simulation of {label}"),
            element("h3", "Left out; if the robot had"),
            _table("effect", WHY, map(_row, budget.of("effect")), f"effects not in {label}"),
            table(
                ("not modelled", "at most, N", "why"),
                [(what, f"{most:.3f}", why) for what, most, why in NOT_MODELLED],
                f"what is not modelled in {label}",
            ),
            element("h3", "If the controller believed"),
            element("p", others),
            _table("belief", WHY, beliefs, f"what beliefs would add in {label}"),
        ]
    )


def _table(cause: str, meaning: str, rows: Iterable[Sequence[Cell]], label: str) -> Markup:
    cells = Table((Column(), *NUMBERS, Column()), [*rows]).cells
    return table((cause, *HEAD, meaning), cells, label)


def _begun(text: str) -> str:
    return text[0].upper() + text[1:]


def _row(one: Contribution) -> tuple[Cell, ...]:
    return (*row(one), one.meaning)
