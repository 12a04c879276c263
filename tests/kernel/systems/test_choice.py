"""Options that say nothing, or contradict each other, are refused in a sentence before anything is read."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.kernel.systems.archives import component, connection, structure, system
from tests.kernel.systems.conftest import Ran
from twin.kernel.errors import InputRefused
from twin.studies.systems.options import kinds, order, steps
from twin.studies.systems.recorded import system_result

TWO = system(
    [component("a", "a.fmu"), component("b", "a.fmu")],
    [connection("a.omega_m", "b.omega_ref")],
)

BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "no kind": (lambda: kinds(["a=1"]), "--kind a=1: expected co_simulation, model_exchange"),
    "a kind misspelt": (lambda: kinds(["model_exchang"]), "did you mean 'model_exchange'"),
    "two kinds": (lambda: kinds(["a=co_simulation", "a=model_exchange"]), "--kind: 'a' is given twice"),
    "two kinds for all": (lambda: kinds(["co_simulation"] * 2), "--kind is given twice without a component"),
    "a step of nobody": (lambda: steps(["5"]), "--step 5: expected COMPONENT=MS with a number above 0"),
    "a step with underscores": (lambda: steps(["a=1_0"]), "--step a=1_0: expected COMPONENT=MS"),
    "no step": (lambda: steps(["a=fast"]), "--step a=fast: expected COMPONENT=MS"),
    "a step back": (lambda: steps(["a=-1"]), "--step a=-1: expected COMPONENT=MS"),
    "a step without end": (lambda: steps(["a=inf"]), "--step a=inf: expected COMPONENT=MS"),
    "a gap in the order": (lambda: order("a,,b"), "--order a,,b: expected names of components with commas"),
    "twice in the order": (lambda: order("a,b,a"), "--order: 'a' is given twice; expected it once"),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
def test_options_without_sense_are_refused(bad: str):
    ask, told = BAD[bad]
    with pytest.raises(InputRefused, match=r".") as refused:
        ask()
    assert told in str(refused.value) and "\n" not in str(refused.value)


def test_names_with_an_equals_sign_and_dots_are_read_from_the_right():
    assert kinds(["arm.a=b=model_exchange"]) == {"arm.a=b": "model_exchange"}
    assert steps(["arm.a=2"]) == {"arm.a": 0.002}
    assert order("b, arm.a") == ["b", "arm.a"] and order("") == []


NAMED = "no such component; known are a, b"
USELESS: dict[str, tuple[dict[str, Any], str]] = {
    "a kind of nothing": ({"kinds": {"c": "model_exchange"}}, f"--kind c: {NAMED}"),
    "a step of nothing": ({"steps": {"c": 0.1}}, f"--step c: {NAMED}"),
    "nothing goes first": ({"order": ["c"]}, f"--order c: {NAMED}"),
    "a solver without equations": (
        {"solver": "rk4"}, "--solver rk4 is of FMUs for model exchange, and all are used for co-simulation; leave it",
    ),
    "the usual solver without equations": ({"solver": "cvode"}, "--solver cvode is of FMUs for model exchange"),
    "a kind that no FMU offers": (
        {"kinds": {"": "model_exchange"}},
        "--kind model_exchange: no FMU is used so; all that have no --kind of their own are co_simulation",
    ),
    "a kind for all where each has its own": (
        {"kinds": {"": "co_simulation", "a": "co_simulation", "b": "co_simulation"}}, "each has one of its own",
    ),
    "an order of those that step at once": (
        {"order": ["b"], "scheme": "jacobi"},
        "with Jacobi coupling, where all step at once; leave it out, or choose --scheme",
    ),
}  # fmt: skip


@pytest.mark.parametrize("useless", USELESS)
def test_what_is_asked_of_nothing_in_the_system_is_refused(ran: Ran, useless: str):
    asked, told = USELESS[useless]
    with pytest.raises(InputRefused) as refused:
        ran(structure(TWO, 0.01), **asked)
    assert told in str(refused.value) and "\n" not in str(refused.value)


def test_what_is_asked_for_and_changes_nothing_is_said(ran: Ran):
    _, facts = ran(structure(TWO, 0.01), loops="solve", lenient=True, state_every=0.01)
    assert facts["without_effect"] == [
        "--loops solve: no algebraic loop was found",
        "--lenient: there was nothing to let through",
        "--state-every-s 0.01: the run is over after 0.01 s",
    ]
    assert "no effect  --lenient: there was nothing to let through" in system_result(facts).text
    alone = structure(system([component("a", "a.fmu")]), 0.01)
    _, facts = ran(alone, scheme="gauss_seidel", order=["a"])
    assert facts["without_effect"] == ["--scheme: there is one FMU, a", "--order: there is one FMU, a"]
    _, facts = ran(structure(TWO, 0.01), state_every=0.005, scheme="jacobi")
    assert facts["without_effect"] == []
