"""Steps of varying length hold a tolerance against the solution of the whole, with fewer steps than ticks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.systems.archives import archive, component, connection, structure, system
from tests.kernel.systems.conftest import Ran
from tests.kernel.systems.linear import Linear, Wire, monolith
from twin.kernel.cosim.adaptive import NAME
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import opened
from twin.studies.systems.recorded import system_result

Case = tuple[dict[str, Linear], list[Wire]]
CASES: dict[str, Case] = {
    # a mass, and a spring with a damper to the wall: its force depends on the motion at once
    "mass and spring": (
        {
            "mass": Linear(a=[[0, 1], [0, 0]], b=[[0], [1]], c=[[1, 0], [0, 1]], x0=[1, 0]),
            "spring": Linear(d=[[-4.0, -0.4]]),
        },
        [("mass.y", "spring.u"), ("mass.v", "spring.w"), ("spring.y", "mass.u")],
    ),
    "two tanks": (
        {"a": Linear(a=[[-1]], b=[[1]], c=[[1]], x0=[1]), "b": Linear(a=[[-2]], b=[[1]], c=[[1]])},
        [("a.y", "b.u"), ("b.y", "a.u")],
    ),
    "two oscillators": (
        {
            "a": Linear(a=[[0, 1], [-9, -0.1]], b=[[0], [3]], c=[[1, 0]], x0=[1, 0]),
            "b": Linear(a=[[0, 1], [-16, -0.1]], b=[[0], [2]], c=[[1, 0]]),
        },
        [("a.y", "b.u"), ("b.y", "a.u")],
    ),
    # a lag of 1 ms behind an oscillator, which takes lines
    "stiff": (
        {
            "b": Linear(a=[[0, 1], [-1, -0.2]], b=[[0], [-1]], c=[[1, 0]], x0=[1, 0]),
            "a": Linear(a=[[-1000]], b=[[1000]], c=[[1]], lines=True),
        },
        [("b.y", "a.u"), ("a.y", "b.u")],
    ),
}
TICKS = {"stiff": 2e-5}
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6)


def ssd(case: Case, stop: float) -> str:
    parts, wires = case
    return structure(
        system([component(name, f"{name}.fmu") for name in parts], [connection(*wire) for wire in wires]), stop
    )


def made(case: Case, folder: Path) -> dict[str, Path]:
    return {f"{name}.fmu": part.fmu(folder / f"{name}.fmu") for name, part in case[0].items()}


def run(case: Case, folder: Path, stop: float, **asked: Any) -> tuple[float, Simulation]:
    """(largest error of all outputs in all rows, of the largest value or 1; the simulation) of a system."""
    package = read_package(archive(folder / "x.ssp", ssd(case, stop), made(case, folder)))
    with opened(package, MasterChoice(**asked)) as (plan, ready):
        simulation = Simulation(ready.system, plan.timing.ticks)
        rows = simulation.run()[::50]
        exact = monolith(*case, plan.timing.tick * 50 * np.arange(len(rows)))
        error = 0.0
        for part in plan.parts:
            for i, output in enumerate(("y", "v")):
                theirs = exact[f"{part.path}.{output}"]
                off = np.abs(rows[:, ready.columns[part.name]][:, i] - theirs).max()
                error = max(error, off / max(1.0, np.abs(theirs).max()))
        return float(error), simulation


@pytest.mark.parametrize("scheme", ["gauss_seidel", pytest.param("jacobi", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CASES)
def test_the_error_of_the_whole_run_is_at_most_ten_tolerances_and_falls_with_them(
    name: str, scheme: str, tmp_path: Path
):
    tick, stop = TICKS.get(name, 1e-4), 1.0 if name in TICKS else 3.0
    errors, steps = [], []
    for tolerance in TOLERANCES:
        error, simulation = run(CASES[name], tmp_path, stop, tolerance=tolerance, tick=tick, scheme=scheme)
        assert error <= 10.0 * tolerance
        assert simulation.control is not None
        counts = simulation.control.counts
        # also with those that are tried in vain
        assert counts["steps"] + counts["rejected"] < round(stop / tick)
        errors.append(error)
        steps.append(counts["steps"])
    assert errors == sorted(errors, reverse=True) and errors[-1] < errors[0] / 100.0
    assert steps == sorted(steps)


def test_steps_of_one_length_would_have_to_be_many_more_for_that_error(tmp_path: Path):
    case = CASES["two oscillators"]
    error, simulation = run(case, tmp_path, 3.0, tolerance=1e-4, tick=1e-4)
    fixed, _ = run(case, tmp_path, 3.0, tick=1e-3)
    # 3000 steps of one length err more
    assert simulation.control is not None and simulation.control.counts["steps"] < 500 and fixed > 2.0 * error


def test_the_estimate_is_recorded_and_rows_lie_on_lines_between_the_ends_of_steps(ran: Ran, tmp_path: Path):
    case = CASES["two tanks"]
    recording, facts = ran(ssd(case, 1.0), made(case, tmp_path), tolerance=1e-4, tick=0.001)
    steps = facts["steps"]
    assert steps["varying"] and steps["error_total"] == recording[f"{NAME}.error_total"][-1] <= 1e-4
    assert np.all(np.diff(recording[f"{NAME}.error_total"]) >= 0.0)
    assert len(recording.time("a")) == 1001
    ends = np.flatnonzero(np.abs(np.diff(recording["a.y"], 2)) > 1e-13) + 1
    lengths = np.unique(recording[f"{NAME}.step"][ends].round(9))
    assert len(lengths) > 2 and np.allclose(lengths / 0.001, np.round(lengths / 0.001))
    assert f"{steps['steps']} steps for 1000 ticks" in " ".join(system_result(facts).text.split())


@pytest.mark.parametrize("kinds", [{}, {"": "model_exchange"}])
def test_equations_and_a_start_later_than_0_go_with_it(ran: Ran, tmp_path: Path, kinds: dict[str, str]):
    case = CASES["two tanks"]
    recording, _ = ran(ssd(case, 3.0), made(case, tmp_path), tolerance=1e-4, tick=0.001, start=2.0, kinds=kinds)
    exact = monolith(*case, recording.time("a") - 2.0)
    assert all(np.abs(recording[name] - exact[name]).max() < 1e-3 for name in ("a.y", "b.y"))


def test_slices_change_no_bit(tmp_path: Path):
    case = CASES["two tanks"]
    package = read_package(archive(tmp_path / "x.ssp", ssd(case, 1.0), made(case, tmp_path)))
    rows = []
    for slice_ticks in (1, 7, 2000):
        with opened(package, MasterChoice(tolerance=1e-4, tick=0.001)) as (plan, ready):
            rows.append(Simulation(ready.system, plan.timing.ticks, slice_ticks).run())
    assert np.array_equal(rows[0], rows[1]) and np.array_equal(rows[0], rows[2])


def test_a_part_that_cannot_be_set_back_keeps_steps_of_one_length_and_that_is_said(ran: Ran, tmp_path: Path):
    parts, wires = CASES["two tanks"]
    stuck = {"a": parts["a"], "b": Linear(**vars(parts["b"]) | {"state": False})}
    fixed, facts = ran(ssd((stuck, wires), 1.0), made((stuck, wires), tmp_path), tolerance=1e-4)
    assert facts["steps"] == {
        "varying": False, "tolerance": 1e-4, "why": "b has no FMU state to go back to (canGetAndSetFMUstate)",
    }  # fmt: skip
    assert "steps      of one length: b has no FMU state" in system_result(facts).text
    plain, _ = ran(ssd((stuck, wires), 1.0), made((stuck, wires), tmp_path))
    assert np.array_equal(fixed["b.y"], plain["b.y"]) and NAME not in fixed.streams


def test_a_component_that_fails_in_a_long_step_fails_in_the_tick_where_it_would_by_itself(ran: Ran, tmp_path: Path):
    # it grows beyond all numbers, and is read
    case = {"a": Linear(a=[[2000]], x0=[1], c=[[1]]), "b": Linear()}, [("a.y", "b.u")]
    told = []
    for asked in ({}, {"tolerance": 1e-2}):
        with pytest.raises(ComponentFailed, match=r"returned (infinity|NaN) for y") as failure:
            ran(ssd(case, 10.0), made(case, tmp_path), tick=0.001, **asked)
        told.append(str(failure.value).partition("Recorded until then")[0])
    assert told[0] == told[1]


def test_no_state_is_saved_and_that_is_said(ran: Ran, tmp_path: Path):
    case = CASES["two tanks"]
    # nor is there a reason to write before a block is full
    _, facts = ran(ssd(case, 1.0), made(case, tmp_path), tolerance=1e-4, tick=0.002, state_every=0.3)
    assert any("no state is saved: master steps by what it has found out" in e["text"] for e in facts["events"])
