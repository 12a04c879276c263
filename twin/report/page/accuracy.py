"""Where the error of a run's force comes from, in newtons, cause by cause."""

from twin.report.page.markup import Markup, element, joined, table
from twin.studies.accuracy.budget import NOT_MODELLED, Budget, Contribution
from twin.studies.accuracy.text import details, headline

NUMBERS = ("bias, N", "std, N", "rms, N")
MEANING = "what it means"
Row = tuple[str, ...]


def accuracy(budget: Budget, label: str) -> Markup:
    """The sentence, what is in the run, and what is not: the twin's own error and beliefs that may be off.

    Args:
        budget: of the run's experiment.
        label: of the run.
    """
    found, why = headline(budget), details(budget)
    together = ("all of them", f"{budget.bias:+.4f}", "", f"{budget.together:.4f}", "sum of biases, root of squares")
    added = ("all of them", "", "", f"{budget.parameters:.4f}", "root of the sum of squares")
    causes = [*map(_row, budget.of("imperfection")), together, _row(budget.as_is)]
    beliefs = [*map(_row, budget.of("parameter")), added]
    others = f"None of this is in the run: each line is another, whose controller believes otherwise. {_begun(why[1])}."
    return joined(
        [
            element("p", f"{_begun(found)}. {_begun(why[0])}."),
            table(("cause", *NUMBERS, MEANING), causes, f"causes of the force error of {label}"),
            element("h3", "The twin itself"),
            table(("cause", *NUMBERS, MEANING), map(_row, budget.of("twin")), f"error of the simulation of {label}"),
            element("h3", "Left out; if the robot had"),
            table(
                ("effect", *NUMBERS, "why so much, assumed"), map(_row, budget.of("effect")), f"effects not in {label}"
            ),
            table(
                ("not modelled", "at most, N", "why"),
                [(what, f"{most:.3f}", why) for what, most, why in NOT_MODELLED],
                f"what is not modelled in {label}",
            ),
            element("h3", "If the controller believed"),
            element("p", others),
            table(("belief", *NUMBERS, "why so much, assumed"), beliefs, f"what beliefs would add in {label}"),
        ]
    )


def _begun(text: str) -> str:
    return text[0].upper() + text[1:]


def _row(one: Contribution) -> Row:
    # a zero has no sign
    return (one.label, f"{round(one.bias, 4) + 0.0:+.4f}", f"{one.std:.4f}", f"{one.rms:.4f}", one.meaning)
