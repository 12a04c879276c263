"""An accuracy budget as text of at most 80 columns: the error first, then what it consists of."""

import textwrap

from twin.accuracy.budget import Budget, Contribution

WIDTH = 80
NAME = 36


def accuracy_text(budget: Budget, facts: str) -> str:
    """The whole report. facts: path of the file."""
    total = budget.as_is
    imperfections = [one for one in budget.contributions if one.group == "imperfection"]
    twin = [one for one in budget.contributions if one.group == "twin"]
    parameters = [one for one in budget.contributions if one.group == "parameter"]
    worst = max(imperfections, key=lambda one: one.rms)
    lines = [
        f"{budget.name}: the force is estimated to {total.rms:.3f} N rms",
        *_wrapped(
            f"pressing {budget.force:.2f} N, {budget.start:.2f} to {budget.end:.2f} s: {abs(total.bias):.3f} N too "
            f"{'high' if total.bias > 0.0 else 'low'} on average, {total.std:.3f} N of scatter; most of it is "
            f"{worst.label}"
        ),
        *_wrapped(f"parameters that are known no better than assumed here may add {budget.parameters:.3f} N"),
        "",
        f"  {'in this run, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in imperfections),
        f"  {'sum of biases, root of squares':<{NAME}}{budget.bias:>+9.4f}{'':>9}{budget.together:>9.4f}",
        _line(total),
        "",
        f"  {'the twin itself, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in twin),
        "",
        f"  {'if the controller believed, N':<{NAME}}{'bias':>9}{'std':>9}{'rms':>9}",
        *(_line(one) for one in parameters),
        f"  {'root of the sum of squares':<{NAME}}{'':>18}{budget.parameters:>9.4f}",
        "",
    ]
    for one in (*imperfections, *twin):
        lines += _wrapped(f"{one.label}: {one.meaning}", "  ")
    return "\n".join([*lines, f"  {'facts':<10} {facts}"])


def _line(one: Contribution) -> str:
    # a zero has no sign
    bias = round(one.bias, 4) + 0.0
    return f"  {one.label:<{NAME}}{bias:>+9.4f}{one.std:>9.4f}{one.rms:>9.4f}"


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="  " + indent)
