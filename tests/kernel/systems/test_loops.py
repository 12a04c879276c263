"""Algebraic loops: found, named, and solved like the whole; else refused with what would do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.systems.archives import archive, component, connection, structure, system
from tests.kernel.systems.conftest import Ran
from tests.kernel.systems.linear import Linear, monolith
from twin.kernel.cosim.loop import LoopComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.loops import find_loops
from twin.kernel.systems.opening import open_system
from twin.studies.systems.recorded import system_result

WIRES = [("mass.y", "load.u"), ("load.y", "mass.u")]
PATH = "load.y -> mass.u -> mass.y -> load.u"


def masses(m_1: float, m_2: float, **more: Any) -> dict[str, Linear]:
    """A mass on a spring of 100 N/m that tells its acceleration, and what hangs at it, a mass that gives a force: both
    are one oscillator of (m_1 + m_2) x'' = -100 x from x = 1. A sweep around the loop multiplies by -m_2/m_1."""
    mass = Linear(
        a=[[0, 1], [-100 / m_1, 0]], b=[[0], [1 / m_1]], c=[[-100 / m_1, 0], [1, 0]], d=[[1 / m_1]], x0=[1, 0],
        experiment='stepSize="0.001"', **more,
    )  # fmt: skip
    return {"mass": mass, "load": Linear(d=[[-m_2]], **more)}


def ssd(stop: float = 0.2, wires: list[tuple[str, str]] = WIRES, parts: tuple[str, ...] = ("mass", "load")) -> str:
    return structure(
        system([component(name, f"{name}.fmu") for name in parts], [connection(*wire) for wire in wires]), stop
    )


def made(parts: dict[str, Linear], folder: Path) -> dict[str, Path]:
    return {f"{name}.fmu": part.fmu(folder / f"{name}.fmu") for name, part in parts.items()}


def test_a_loop_is_named_with_its_path_and_delayed_unless_it_is_to_be_solved(ran: Ran, tmp_path: Path):
    run, facts = ran(ssd(), made(masses(2.0, 6.0), tmp_path))
    assert facts["loops"] == [{"path": PATH, "solved": False, "unstated": []}]
    assert f"loop       {PATH}, not solved, one value" in system_result(facts).text
    # every step multiplies what is late by 3
    assert np.abs(run["mass.y"]).max() > 1e50


@pytest.mark.parametrize("kinds", [{}, {"": "model_exchange"}, {"load": "model_exchange"}], ids=["cs", "me", "both"])
@pytest.mark.parametrize("ratio", [0.5, 3.0], ids=["contracting", "growing"])
def test_two_masses_in_a_loop_move_like_one(ran: Ran, tmp_path: Path, ratio: float, kinds: dict[str, str]):
    # ratio 3: passes alone would grow by 3 each time, Newton's method does not care
    parts = masses(2.0, 2.0 * ratio)
    resources, errors = made(parts, tmp_path), []
    for tick in (0.002, 0.001):
        # of order 4, so that nothing but the coupling is left
        run, facts = ran(ssd(), resources, loops="solve", kinds=kinds, tick=tick, solver="rk4" if kinds else None)
        exact = monolith(parts, WIRES, run.time("mass"))
        omega = np.sqrt(100.0 / (2.0 + 2.0 * ratio))
        assert np.allclose(exact["mass.v"], np.cos(omega * run.time("mass")), atol=1e-12)
        # force and acceleration agree in every row, by the bound of the residual
        assert np.abs(run["load.y"] + parts["load"].d[0][0] * -run["mass.y"]).max() < 1e-6 * 100.0
        errors.append(np.abs(run["mass.v"] - exact["mass.v"]).max())
    (loop,) = facts["loops"]
    assert (loop["path"], loop["solved"], loop["unstated"]) == (PATH, True, [])
    assert loop["microseconds_per_step"] > 0.0 and facts["components"]["mass"]["microseconds_per_step"] is None
    assert "in a loop" in system_result(facts).text
    # values are held over a step: of order one
    assert errors[0] < 0.03 and errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_a_loop_between_others_is_solved_and_they_step_in_their_order(ran: Ran, tmp_path: Path):
    parts = {"first": Linear(a=[[-1]], c=[[1]], x0=[1]), "mass": masses(2.0, 1.0)["mass"]}
    parts |= {"between": Linear(a=[[-3]], b=[[1]], c=[[1]]), "load": masses(2.0, 1.0)["load"]}
    parts["load"] = Linear(d=[[-1.0, 0.5]])
    wires = [*WIRES, ("first.y", "load.w"), ("mass.v", "between.u")]
    run, facts = ran(ssd(0.2, wires, tuple(parts)), made(parts, tmp_path), loops="solve", tick=0.0005)
    assert [one["path"] for one in facts["loops"]] == [PATH]
    exact = monolith(parts, wires, run.time("mass"))
    for name in ("first.y", "mass.v", "mass.y", "between.y", "load.y"):
        assert np.abs(run[name] - exact[name]).max() < 5e-3 * np.abs(exact[name]).max()


def test_no_loop_is_found_where_outputs_do_not_depend_on_inputs_and_the_bits_are_the_same(ran: Ran, tmp_path: Path):
    spring = Linear(a=[[0, 1], [-4, -1]], b=[[0], [1]], c=[[1, 0]], x0=[1, 0])
    parts = {"mass": spring, "load": Linear(d=[[-2.0]])}
    resources = made(parts, tmp_path)
    delayed, facts = ran(ssd(), resources)
    solved, _ = ran(ssd(), resources, loops="solve")
    assert facts["loops"] == []
    assert all(np.array_equal(delayed[name], solved[name]) for name in ("mass.y", "load.y"))


def test_an_fmu_that_does_not_say_what_its_outputs_depend_on_may_close_a_loop(ran: Ran, tmp_path: Path):
    parts = masses(2.0, 1.0, stated=False)
    _, facts = ran(ssd(), made(parts, tmp_path))
    assert facts["loops"][0]["unstated"] == ["mass", "load"] or facts["loops"][0]["unstated"] == ["load", "mass"]
    assert "does not state what its outputs depend on" in " ".join(system_result(facts).text.split())


def test_a_loop_of_fmus_that_cannot_go_back_is_refused_with_what_would_do(ran: Ran, tmp_path: Path):
    resources = made(masses(2.0, 1.0, state=False), tmp_path)
    with pytest.raises(InputRefused) as refused:
        ran(ssd(), resources, loops="solve")
    assert str(refused.value).endswith(
        f"mass of the loop {PATH} has no FMU state to go back to the start of a step (canGetAndSetFMUstate); "
        "--kind mass=model_exchange or --kind load=model_exchange or --loops delay does without"
    )
    # which is so: equations are asked where they are, without a state
    run, _ = ran(ssd(), resources, loops="solve", kinds={"": "model_exchange"})
    exact = monolith(masses(2.0, 1.0), WIRES, run.time("mass"))
    assert np.abs(run["mass.v"] - exact["mass.v"]).max() < 0.02
    alone = made(masses(2.0, 1.0, state=False, kinds=["CoSimulation"]), tmp_path)
    with pytest.raises(InputRefused, match=r"\(canGetAndSetFMUstate\); --loops delay does without$"):
        ran(ssd(), alone, loops="solve")


def test_a_loop_without_a_solution_is_refused_at_the_start(ran: Ran, tmp_path: Path):
    # y = u + 1 and u = y
    parts = {"mass": Linear(c=[[1]], d=[[1]], x0=[1], a=[[0]]), "load": Linear(d=[[1.0]])}
    with pytest.raises(InputRefused, match=r"no start values of the loop .* are found: the residual is .* passes"):
        ran(ssd(), made(parts, tmp_path), loops="solve", tick=0.001)


def test_a_loop_that_loses_its_solution_ends_the_run_with_tick_residual_and_path(ran: Ran, tmp_path: Path):
    # y = u + x with x = 0 at the start, where any value solves u = y, and x = t behind it
    clock = Linear(a=[[0, 1], [0, 0]], x0=[0, 1], c=[[1]], d=[[1]])
    parts = {"mass": clock, "load": Linear(d=[[1.0]])}
    with pytest.raises(ComponentFailed) as failure:
        ran(ssd(), made(parts, tmp_path), loops="solve", tick=0.001)
    told = str(failure.value)
    assert f"the loop (mass+load) {PATH} does not converge: the residual is" in told
    assert "tick 0" in told and "--loops delay does without" in told and "Recorded until then" in told


def test_a_state_of_a_run_with_a_solved_loop_goes_on_with_the_same_bits(ran: Ran, tmp_path: Path):
    resources = made(masses(2.0, 3.0), tmp_path)
    whole, _ = ran(ssd(), resources, loops="solve", tick=0.001, state_every=0.05)
    part, _ = ran(ssd(), resources, loops="solve", tick=0.001, start_from=f"{tmp_path / 'run_1'}@0.1")
    for name in ("mass.y", "mass.v", "load.y"):
        assert np.array_equal(part[name], whole[name][100:])


def test_few_passes_are_needed_once_the_loop_is_known(tmp_path: Path):
    parts = masses(2.0, 6.0)
    package = read_package(archive(tmp_path / "x.ssp", ssd(0.1), made(parts, tmp_path)))
    with open_system(package, MasterChoice(loops="solve", tick=0.001)) as (plan, ready):
        assert len(find_loops(plan)) == 1
        (loop,) = ready.system.components
        Simulation(ready.system, plan.timing.ticks).run()
        # linear: one pass with what is predicted, one that confirms what Newton's method makes of it
        assert isinstance(loop, LoopComponent) and loop.passes == 2


def test_a_loop_through_states_is_none_to_be_solved_and_its_values_are_late_by_part_of_a_step(ran: Ran, tmp_path: Path):
    # two masses of 1 kg between three springs with dampers: the second gives a force that follows from states alone
    k_1, k_2, k_3, c_1, c_2, c_3 = 10.0, 10.0, 20.0, 0.2, 0.5, 0.3
    second = Linear(
        a=[[0, 1], [-(k_2 + k_3), -(c_2 + c_3)]], b=[[0, 0], [k_2, c_2]], c=[[k_2, c_2], [1, 0]],
        d=[[-k_2, -c_2], [0, 0]], x0=[0.5, 0],
    )  # fmt: skip
    first = Linear(a=[[0, 1], [-k_1, -c_1]], b=[[0], [1]], c=[[1, 0], [0, 1]], x0=[0, 0])
    parts = {"first": first, "second": second}
    wires = [("second.y", "first.u"), ("first.y", "second.u"), ("first.v", "second.w")]
    resources, errors = made(parts, tmp_path), []
    for tick in (0.01, 0.005):
        structured = ssd(5.0, wires, ("first", "second"))
        run, facts = ran(structured, resources, loops="solve", kinds={"": "model_exchange"}, tick=tick)
        assert facts["loops"] == []
        exact = monolith(parts, wires, run.time("first"))
        errors.append(np.abs(run["first.y"] - exact["first.y"]).max())
    # 1.2 m for each second of a step, as of the FMUs that OMSimulator's tests have of this
    assert errors[0] == pytest.approx(1.2 * 0.01, rel=0.1) and errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
