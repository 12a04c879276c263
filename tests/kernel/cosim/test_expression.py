"""Expressions of time say what their grammar says, and nothing else is read."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.cosim.expression import MAX_LENGTH, parse_expression
from twin.kernel.errors import InputRefused

times = st.floats(0.0, 100.0)


def leaf() -> st.SearchStrategy[tuple[str, object]]:
    """(text, the same as Python) of what has no parts."""
    numbers = st.floats(-5.0, 5.0).map(lambda x: (f"({x!r})", lambda t: x))
    return st.one_of(numbers, st.just(("t", lambda t: t)), st.just(("pi", lambda t: math.pi)))


def joined(parts: st.SearchStrategy) -> st.SearchStrategy:
    def two(pair):
        (a, f), (b, g), op = pair
        does = {"+": lambda x, y: x + y, "-": lambda x, y: x - y, "*": lambda x, y: x * y}[op]
        return f"({a} {op} {b})", lambda t: does(f(t), g(t))

    def one(pair):
        (a, f), name = pair
        return f"{name}({a})", lambda t: {"sin": math.sin, "cos": math.cos, "-": lambda x: -x}[name](f(t))

    return st.one_of(
        st.tuples(parts, parts, st.sampled_from("+-*")).map(two),
        st.tuples(parts, st.sampled_from(["sin", "cos", "-"])).map(one),
    )


@given(st.recursive(leaf(), joined, max_leaves=12), times)
def test_an_expression_has_the_value_that_python_gives_it(pair, t: float):
    text, meaning = pair
    if len(text) <= MAX_LENGTH:
        assert parse_expression(text, "x").value_at(t) == pytest.approx(meaning(t), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("2*step(1.0)", {0.0: 0.0, 0.999: 0.0, 1.0: 2.0, 5.0: 2.0}),
        # three ticks of 0.1 s are more than 0.3 s, eight fewer than 0.8 s
        ("step(0.3) + step(0.8)", {0.2: 0.0, 3 * 0.1: 1.0, 0.8 - 1e-16: 2.0}),
        ("ramp(1)", {0.5: 0.0, 3.0: 2.0}),
        ("ramp(1, 4)", {1.0: 0.0, 2.0: 0.25, 5.0: 1.0, 9.0: 1.0}),
        ("ramp(1, 0)", {0.9: 0.0, 1.0: 1.0}),
        ("pulse(1, 2)", {0.9: 0.0, 1.0: 1.0, 2.9: 1.0, 3.0: 0.0, 9.0: 0.0}),
        ("pulse(1, 2, 5)", {0.5: 0.0, 1.0: 1.0, 3.0: 0.0, 6.0: 1.0, 7.9: 1.0, 8.0: 0.0}),
        ("-t**2 + 1", {3.0: -8.0}),
        ("exp(-t)/2", {0.0: 0.5}),
    ],
)
def test_steps_ramps_and_pulses_begin_and_end_at_their_ticks(text: str, values: dict[float, float]):
    found = parse_expression(text, "x")
    assert {t: found.value_at(t) for t in values} == pytest.approx(values, abs=1e-15)


def test_where_there_is_no_value_it_is_nan():
    assert math.isnan(parse_expression("0/0", "x").value_at(0.0)) and math.isnan(
        parse_expression("pulse(0, 1, 0)", "x").value_at(1.0)
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("__import__('os').system('x')", "is not allowed"),
        ("t.real", "is not allowed"),
        ("[1]", "is not allowed"),
        ("sim(t)", "'sim' is not known; did you mean 'sin'?"),
        ("x + 1", "'x' is not known"),
        ("step()", "step of 0 arguments; expected 1"),
        ("pulse(1)", "pulse of 1 arguments; expected 2 or 3"),
        ("1 +", "is neither a file nor an expression; expected numbers, t, pi"),
        ("True", "is not allowed"),
        ("1e999", "beyond the range of numbers"),
        ("9" * 900, "beyond the range of numbers"),
        ("(" * 400 + "t" + ")" * 400, "expression"),
        ("-" * 900 + "t", "brackets"),
        ("t" * 1001, "1001 characters; expected at most 1000"),
        ("step(start=1)", "is not allowed"),
    ],
)
def test_what_is_not_of_the_grammar_is_refused(text: str, told: str):
    try:
        parse_expression(text, "--input u")
    except InputRefused as refused:
        assert str(refused).startswith("--input u") and told in str(refused)
    else:
        # Python's parser may take that many
        assert told in ("brackets", "expression")
