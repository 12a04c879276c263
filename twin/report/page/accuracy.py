"""Where the error of a run's force comes from, in newtons, cause by cause."""

from twin.accuracy.budget import Budget, Contribution
from twin.report.accuracy_text import details, headline
from twin.report.page.markup import Markup, element, joined, table

HEAD = ("cause", "what it means", "bias, N", "std, N", "rms, N")
Row = tuple[str, ...]


def accuracy(budget: Budget, label: str) -> Markup:
    """The sentence, what is in the run, and what is not: the twin's own error and beliefs that may be off.

    Args:
        budget: of the run's experiment. label: of the run.
    """
    found, why = headline(budget), details(budget)
    causes = [
        *map(_row, budget.of("imperfection")),
        ("all of them", "sum of the biases, root of the sum of the squares", f"{budget.bias:+.4f}", "",
         f"{budget.together:.4f}"),
        _row(budget.as_is),
    ]  # fmt: skip
    beliefs = [
        *map(_row, budget.of("parameter")),
        ("all of them", "root of the sum of the squares", "", "", f"{budget.parameters:.4f}"),
    ]
    return joined(
        [
            element("p", *(f"{text[0].upper()}{text[1:]}. " for text in (found, why[0]))),
            table(HEAD, causes, f"causes of the force error of {label}"),
            element("h3", "The twin itself"),
            table(HEAD, map(_row, budget.of("twin")), f"error of the simulation of {label}"),
            element("h3", "If the controller believed"),
            element("p", f"Not in this run, whose beliefs are what they are: {why[1]}."),
            table(HEAD, beliefs, f"what beliefs that are off would add in {label}"),
        ]
    )


def _row(one: Contribution) -> Row:
    # a zero has no sign
    return (one.label, one.meaning, f"{round(one.bias, 4) + 0.0:+.4f}", f"{one.std:.4f}", f"{one.rms:.4f}")
