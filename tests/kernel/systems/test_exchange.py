"""Model exchange in systems: which kind is taken, and that its numbers are those of the equations."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.exchange.equations import exact_motor
from tests.kernel.fmi.exchange.fmus import NoCompiler, exchange_fmu
from tests.kernel.systems.archives import component, connection, structure, system, values
from tests.kernel.systems.conftest import Ran
from tests.kernel.systems.linear import Linear, monolith
from twin.kernel.errors import InputRefused

SPRING = Linear(a=[[0, 1], [-4, 0]], b=[[0], [1]], c=[[1, 0], [0, 1]], x0=[1, 0])
LAG = Linear(a=[[-2]], b=[[1]], c=[[1]])
WIRE = connection("spring.y", "lag.u")


def ssd(stop: float = 1.0, first: str = "", second: str = "") -> str:
    parts = [component("spring", "s.fmu", more=first), component("lag", "l.fmu", more=second)]
    return structure(system(parts, [WIRE]), stop)


@pytest.fixture
def fmus(tmp_path: Path) -> dict[str, Path]:
    return {"s.fmu": SPRING.fmu(tmp_path / "s.fmu"), "l.fmu": LAG.fmu(tmp_path / "l.fmu")}


def kinds(facts: dict) -> list[str]:
    return [one["kind"] for one in facts["components"].values()]


def test_an_fmu_that_is_both_takes_co_simulation_unless_something_says_otherwise(ran: Ran, fmus: dict[str, Path]):
    exchange, both = "model_exchange", ["co_simulation"] * 2
    assert kinds(ran(ssd(), fmus)[1]) == both
    assert kinds(ran(ssd(), fmus, kinds={"": exchange})[1]) == [exchange] * 2
    assert kinds(ran(ssd(), fmus, kinds={"lag": exchange})[1]) == ["co_simulation", exchange]
    stated = ssd(second='implementation="ModelExchange"')
    assert kinds(ran(stated, fmus)[1]) == ["co_simulation", exchange]
    # by name against what the system says, for all only where it says nothing
    assert kinds(ran(stated, fmus, kinds={"lag": "co_simulation"})[1]) == both
    assert kinds(ran(stated, fmus, kinds={"": "co_simulation"})[1]) == ["co_simulation", exchange]


def test_a_solver_of_none_names_one_that_may_have_it(ran: Ran, fmus: dict[str, Path]):
    with pytest.raises(InputRefused, match=r"leave it out, or choose --kind \w+=model_exchange$"):
        ran(ssd(2.0), fmus, solver="rk4")


def test_one_that_is_for_model_exchange_alone_is_solved_and_cannot_be_asked_for_co_simulation(
    ran: Ran, fmus: dict[str, Path], tmp_path: Path
):
    alone = fmus | {"s.fmu": Linear(**vars(SPRING) | {"kinds": ["ModelExchange"]}).fmu(tmp_path / "alone.fmu")}
    run, facts = ran(ssd(), alone)
    assert kinds(facts) == ["model_exchange", "co_simulation"]
    assert np.allclose(run["spring.y"], np.cos(2 * run.time("spring")), atol=1e-5)
    with pytest.raises(InputRefused, match=r"offers model exchange alone, and --kind spring=co_simulation"):
        ran(ssd(), alone, kinds={"spring": "co_simulation"})
    # nothing that can be is asked for
    assert kinds(ran(ssd(), alone, kinds={"": "co_simulation"})[1]) == ["model_exchange", "co_simulation"]
    stated = ssd(first='implementation="CoSimulation"')
    with pytest.raises(InputRefused, match="alone, and its component spring is to be used for co-simulation"):
        ran(stated, alone)


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
def test_equations_in_a_system_have_the_solution_of_the_whole(ran: Ran, fmus: dict[str, Path], solver: str):
    errors = []
    for tick in (0.02, 0.01):
        run, _ = ran(ssd(2.0), fmus, kinds={"": "model_exchange"}, solver=solver, tick=tick)
        exact = monolith({"spring": SPRING, "lag": LAG}, [("spring.y", "lag.u")], run.time("lag"))
        # an oscillator alone: what the solver leaves, CVODE at its usual tolerance
        assert np.abs(run["spring.y"] - exact["spring.y"]).max() < 2e-5
        errors.append(np.abs(run["lag.y"] - exact["lag.y"]).max())
    # an input that is held for a step is of order one
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("fmi", [2, 3])
def test_events_in_a_system_are_those_of_the_equations(ran: Ran, tmp_path: Path, fmi: int):
    try:
        motor = exchange_fmu(tmp_path, "motor", fmi)
    except NoCompiler as problem:
        pytest.skip(str(problem))
    # a current limiter (state events), a supply that switches (time events)
    given = {"i_max": 0.3, "switch_every": 0.0123}
    bound = values("omega_ref=3", *(f"{name}={value}" for name, value in given.items()))
    whole = system([component("motor", "m.fmu", bindings=bound)])
    run, facts = ran(structure(whole, 0.1), {"m.fmu": motor}, tick=0.001)
    exact = exact_motor(np.full(101, 3.0), np.zeros(101), 1e-3, **given)
    assert kinds(facts) == ["model_exchange"]
    # of its range, by the FMU's usual tolerance of 1e-6 and 100 events
    for column, name in enumerate(("theta_m", "omega_m", "current")):
        off = np.abs(run[f"motor.{name}"] - exact[:, column]).max()
        assert off < 1e-3 * np.ptp(exact[:, column])


def test_inputs_and_outputs_of_equations_agree_before_the_first_step(ran: Ran, tmp_path: Path):
    resources = {
        "g.fmu": Linear(d=[[3.0]], kinds=["ModelExchange"]).fmu(tmp_path / "g.fmu"),
        "s.fmu": SPRING.fmu(tmp_path / "s.fmu"),
    }
    parts = [component("spring", "s.fmu"), component("gain", "g.fmu")]
    run, _ = ran(structure(system(parts, [connection("spring.y", "gain.u")]), 0.1), resources)
    assert run["gain.y"][0] == 3.0
    # held: what it makes at the end of a step is of the newest value that it was given
    assert run["gain.y"][1] == pytest.approx(3.0 * math.cos(0.02), rel=1e-6)
