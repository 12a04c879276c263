"""An accuracy budget as text of at most 80 columns: the error first, then what it consists of."""

from collections.abc import Sequence

from twin.studies.accuracy.budget import NOT_MODELLED, Budget, Contribution
from twin.studies.result import Block, Column, Note, Result, Table

NAME = 36
NUMBERS = (Column("bias", 8, "+.4f"), Column("std", 8, ".4f"), Column("rms", 8, ".4f"))
Row = tuple[str, float | None, float | None, float]


def accuracy_result(budget: Budget, facts: str) -> Result:
    """The whole report. facts: path of the file."""
    imperfections, twin = budget.of("imperfection"), budget.of("twin")
    together = ("sum of biases, root of squares", budget.bias, None, budget.together)
    left_out = [f"  {what:<{NAME - 3}}{'not modelled, at most':>21}{most:>9.3f}" for what, most, _ in NOT_MODELLED]
    beliefs = [*map(row, budget.of("parameter")), ("root of the sum of squares", None, None, budget.parameters)]
    parts: list[Block] = [
        *(Note(sentence, "  ") for sentence in details(budget)),
        "",
        _table("in this run, N", [*map(row, imperfections), together, row(budget.as_is)]),
        "",
        _table("the twin itself, N", [*map(row, twin)]),
        "",
        _table("left out; if the robot had, N", [*map(row, budget.of("effect")), *left_out]),
        "",
        _table("if the controller believed, N", beliefs),
        "",
        *(Note(f"{one.label}: {one.meaning}", "  ", 4) for one in (*imperfections, *twin)),
    ]
    return Result(
        f"{budget.name}: {headline(budget)}", parts, accuracy_facts(budget) | {"facts": facts}, {"facts": facts}
    )


def _table(title: str, rows: Sequence[Row | str]) -> Table:
    return Table([Column(title, NAME, left=True), *NUMBERS], rows)


def headline(budget: Budget) -> str:
    """The whole in half a sentence."""
    return f"the force is estimated to {budget.as_is.rms:.3f} N rms"


def details(budget: Budget) -> tuple[str, str]:
    """What the error consists of, and what might be added; half a sentence each."""
    total, worst = budget.as_is, max(budget.of("imperfection"), key=lambda one: one.rms)
    off = f"{abs(total.bias):.3f} N too {'high' if total.bias > 0.0 else 'low'}"
    # three digits, as they are shown
    off = off if abs(total.bias) >= 5e-4 else "right"
    return (
        f"pressing {budget.force:.2f} N, {budget.start:.2f} to {budget.end:.2f} s: {off} on average, "
        f"{total.std:.3f} N of scatter; most of it is {worst.label}",
        f"parameters that are known no better than assumed here may add {budget.parameters:.3f} N",
    )


def row(one: Contribution) -> Row:
    """Label, bias, standard deviation and rms (N)."""
    return one.label, one.bias, one.std, one.rms


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
