import pytest

from twin.robot.experiment.measure import (
    BooleanOp,
    Inequality,
    Negation,
    Predicate,
    Temporal,
    Term,
    UntilFormula,
    parse_requirement,
    signals_of,
)


def test_a_bound_on_a_force_is_a_comparison_in_newtons():
    formula = parse_requirement("always (|plant.F_ee_B| <= 18 N)")
    assert isinstance(formula, Temporal) and (formula.operator, formula.begin, formula.end) == ("always", 0.0, None)
    assert isinstance(formula.operand, Inequality)
    (size,), (bound,) = formula.operand.smaller, formula.operand.larger
    assert size.value == (Term(1, "plant.F_ee_B"),)
    assert bound.value == 18.0 and bound.unit is not None and bound.unit.si == "N"


def test_numbers_are_si_and_the_greater_side_may_stand_first():
    formula = parse_requirement("plant.p_B[2] > 2 mm")
    assert isinstance(formula, Inequality)
    assert formula.smaller[0].value == 0.002
    assert formula.larger == (Term(1, "plant.p_B", 2),)


def test_implies_binds_weakest_and_until_stronger_than_and():
    formula = parse_requirement("a.x implies b.y and c.z until[0 s, 2 s] d.w")
    assert formula == BooleanOp(
        "or",
        Negation(Predicate("a.x")),
        BooleanOp("and", Predicate("b.y"), UntilFormula(Predicate("c.z"), Predicate("d.w"), 0.0, 2.0)),
    )


def test_and_binds_stronger_than_or_and_brackets_stronger_than_both():
    assert parse_requirement("a.x or b.y and c.z") == BooleanOp(
        "or", Predicate("a.x"), BooleanOp("and", Predicate("b.y"), Predicate("c.z"))
    )
    assert parse_requirement("(a.x or b.y) and c.z") == BooleanOp(
        "and", BooleanOp("or", Predicate("a.x"), Predicate("b.y")), Predicate("c.z")
    )


def test_a_sum_keeps_its_signs():
    formula = parse_requirement("|plant.p_B[2] - controller.p_ref_B[2]| <= 1 mm + 2 um")
    assert [name for name, _ in signals_of(formula)] == ["plant.p_B", "controller.p_ref_B"]
    assert isinstance(formula, Inequality) and [term.value for term in formula.larger] == [0.001, 2e-6]
    inside = formula.smaller[0].value
    assert isinstance(inside, tuple) and [term.sign for term in inside] == [1, -1]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "got the end"),
        ("always (plant.z <= 3 N", "expected '\\)', got the end"),
        ("plant.z <= 3 Newton", "unit 'Newton': no such unit"),
        ("plant.z[0]", "expected '<=' or '>='"),
        ("perhaps (plant.z <= 3 N)", "unknown word 'perhaps'"),
        ("always[2 s, 1 s] plant.z", "expected the earlier time first"),
        ("always[0 N, 1 s] plant.z", "an interval in N"),
        ("always[0, 1 s] plant.z", "an interval in 1; expected times such as"),
        ("plant.z <= 3 N plant.z", "expected 'and', 'or', 'implies', 'until' or the end, got 'plant.z'"),
        ("plant.z <= ; 3 N", "got '; 3 N'"),
        ("not " * 3000, "characters; expected at most"),
        ("(" * 1999, "got the end|nested too deeply"),
    ],
)
def test_what_is_no_formula_is_refused_with_where(text, told):
    with pytest.raises(ValueError, match=told):
        parse_requirement(text)
