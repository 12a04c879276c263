"""An accuracy budget as text of at most 80 columns: the error first, then what it consists of."""

from twin.studies.accuracy.budget import NOT_MODELLED, Budget, Contribution
from twin.studies.lines import wrapped

NAME = 36


def accuracy_text(budget: Budget, facts: str) -> str:
    """The whole report. facts: path of the file."""
    imperfections, twin, parameters = (budget.of(group) for group in ("imperfection", "twin", "parameter"))
    lines = [
        f"{budget.name}: {headline(budget)}",
        *(line for sentence in details(budget) for line in wrapped(sentence, "  ")),
        "",
        f"  {'in this run, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in imperfections),
        f"  {'sum of biases, root of squares':<{NAME}}{budget.bias:>+9.4f}{'':>9}{budget.together:>9.4f}",
        _line(budget.as_is),
        "",
        f"  {'the twin itself, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in twin),
        "",
        f"  {'left out; if the robot had, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in budget.of("effect")),
        *(f"  {what:<{NAME - 3}}{'not modelled, at most':>21}{most:>9.3f}" for what, most, _ in NOT_MODELLED),
        "",
        f"  {'if the controller believed, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in parameters),
        f"  {'root of the sum of squares':<{NAME}}{'':>18}{budget.parameters:>9.4f}",
        "",
    ]
    for one in (*imperfections, *twin):
        lines += wrapped(f"{one.label}: {one.meaning}", "  ", 4)
    return "\n".join([*lines, f"  {'facts':<10} {facts}"])


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


def _line(one: Contribution) -> str:
    # a zero has no sign
    bias = round(one.bias, 4) + 0.0
    return f"  {one.label:<{NAME}}{bias:>+9.4f}{one.std:>9.4f}{one.rms:>9.4f}"


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
