"""Options that say nothing, or contradict each other, are refused in a sentence before anything is read."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.kernel.systems.archives import component, connection, structure, system
from tests.kernel.systems.conftest import Ran
from twin.kernel.errors import InputRefused
from twin.kernel.systems.choice import MasterChoice, kinds, order, steps

BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "no kind": (lambda: kinds(["a=1"]), "--kind a=1: expected co_simulation, model_exchange"),
    "a kind misspelt": (lambda: kinds(["model_exchang"]), "did you mean 'model_exchange'"),
    "two kinds": (lambda: kinds(["a=co_simulation", "a=model_exchange"]), "--kind: 'a' is given twice"),
    "two kinds for all": (lambda: kinds(["co_simulation"] * 2), "--kind is given twice without a component"),
    "a step of nobody": (lambda: steps(["5"]), "--step 5: expected COMPONENT=MS with a number above 0"),
    "no step": (lambda: steps(["a=fast"]), "--step a=fast: expected COMPONENT=MS"),
    "a step back": (lambda: steps(["a=-1"]), "--step a=-1: expected COMPONENT=MS"),
    "a step without end": (lambda: steps(["a=inf"]), "--step a=inf: expected COMPONENT=MS"),
    "a gap in the order": (lambda: order("a,,b"), "--order a,,b: expected names of components with commas"),
    "twice in the order": (lambda: order("a,b,a"), "--order: 'a' is given twice; expected it once"),
    "a tolerance of 0": (lambda: MasterChoice(tolerance=0.0), "--tolerance 0: expected a number above 0, at most 0.1"),
    "no tolerance": (lambda: MasterChoice(tolerance=float("nan")), "--tolerance nan: expected a number above 0"),
    "two who choose steps": (
        lambda: MasterChoice(tolerance=1e-3, steps={"a": 0.1}), "does not go with --step; leave one of them out",
    ),
    "loops in varying steps": (
        lambda: MasterChoice(tolerance=1e-3, loops="solve"), "does not go with --loops solve; leave one of them out",
    ),
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


@pytest.mark.parametrize(
    ("asked", "option"),
    [({"kinds": {"c": "model_exchange"}}, "--kind"), ({"steps": {"c": 0.1}}, "--step"), ({"order": ["c"]}, "--order")],
)
def test_options_of_no_component_are_refused(ran: Ran, asked: dict[str, Any], option: str):
    parts = [component("a", "a.fmu"), component("b", "a.fmu")]
    ssd = structure(system(parts, [connection("a.omega_m", "b.omega_ref")]), 0.01)
    with pytest.raises(InputRefused, match=f"{option} c: no such component; known are a, b"):
        ran(ssd, **asked)
