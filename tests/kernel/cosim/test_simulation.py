"""What a failing component leaves behind: one sentence, and every row before it."""

import ctypes
import math
import re

import numpy as np
import pytest

from tests.kernel.cosim.models import Part, U, clock, continuous, echo, sampled
from twin.kernel.cosim.component import Component, step_function
from twin.kernel.cosim.delay import delay
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed

TICK = 0.1
FAILS_AT = 5
OMEGA = Port("omega_ref", 1, "rad/s")
PAIR = Port("tau", 2, "N m")
NOTHING = np.dtype([("unused", "i8")], align=True)

STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


def native(name: str, status: int) -> Component:
    """A continuous component without ports whose step returns `status` from tick `FAILS_AT` on."""
    function = STEP(lambda self, t, h, u, y: status if round(t / TICK) >= FAILS_AT else 0)
    address = ctypes.cast(function, ctypes.c_void_p).value or 0
    return Component(name, (), (), False, address, 0, np.zeros(0), keep=function)


def system(culprit: Component) -> System:
    """`culprit` behind a counter of ticks and a constant pair, and before a bystander."""
    count = sampled("count", lambda t, h, u: round(t / TICK), outputs=(OMEGA,))
    pair = sampled("pair", lambda t, h, u: (0.5, -0.25), outputs=(PAIR,))
    wires = [("count.omega_ref", "culprit.omega_ref"), ("pair.tau", "culprit.tau")] if culprit.inputs else []
    return System([count, pair, culprit, continuous("bystander", lambda t, h, u: t + h)], wires, TICK)


def failure(culprit: Component, slice_ticks: int = 100) -> tuple[str, np.ndarray]:
    """The sentence, and the rows that were delivered."""
    simulation = Simulation(system(culprit), 20, slice_ticks)
    slices = []
    while not simulation.is_over:
        slices.append(simulation.advance().copy())
    assert simulation.failure is not None
    return str(simulation.failure), np.concatenate(slices)


def failing(is_sampled: bool, bad: float) -> Part:
    """Outputs (u, 1) until tick `FAILS_AT`, then `bad` as the second."""

    def law(t, h, u):
        return u[0], bad if u[0] >= FAILS_AT else 1.0

    return Part("culprit", law, is_sampled, (OMEGA, PAIR), (Port("a"), Port("b")))


def raising(is_sampled: bool, exception: BaseException, period: int = 1) -> Part:
    def law(t, h, u):
        if u[0] >= FAILS_AT:
            raise exception
        return u[0], 1.0

    return Part("culprit", law, is_sampled, (OMEGA, PAIR), (Port("a"), Port("b")), period)


INPUTS = "Last inputs: omega_ref = 5 rad/s, tau = (0.5, -0.25) N m."


@pytest.mark.parametrize(("bad", "called"), [(math.nan, "NaN"), (math.inf, "infinity"), (-math.inf, "infinity")])
@pytest.mark.parametrize(
    ("is_sampled", "when"), [(True, "at t = 0.5 s, tick 5"), (False, "in the step from t = 0.5 s, tick 5")]
)
def test_a_value_that_is_not_finite_stops_the_run_and_names_the_port(bad, called, is_sampled, when):
    sentence, _ = failure(failing(is_sampled, bad))
    assert sentence == f"Model (culprit) returned {called} for b {when}. {INPUTS}"


@pytest.mark.parametrize("is_sampled", [True, False])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_component_that_need_not_be_finite_lives_on_and_its_values_are_recorded(bad, is_sampled):
    culprit = failing(is_sampled, bad)
    culprit.finite = False
    joined = system(culprit)
    rows = Simulation(joined, 20).run()
    # a continuous component fails in the step from that tick, so its row shows it one tick later
    clean = FAILS_AT + (0 if is_sampled else 1)
    np.testing.assert_array_equal(rows[clean:, joined.columns("culprit.b")], bad)
    assert np.all(np.isfinite(rows[:clean]))


def test_a_bad_status_ends_the_run_of_a_component_that_need_not_be_finite():
    culprit = native("culprit", 2)
    culprit.finite = False
    sentence, _ = failure(culprit)
    assert sentence.startswith("culprit returned status 2")


@pytest.mark.parametrize(
    ("is_sampled", "when"), [(True, "at t = 0.5 s, tick 5"), (False, "in the step from t = 0.5 s, tick 5")]
)
def test_an_exception_in_a_python_component_is_told(is_sampled, when):
    sentence, _ = failure(raising(is_sampled, ValueError("no such angle")))
    sentence = re.sub(r" \(\w+\.py, line \d+\)", " (LINE)", sentence)
    assert sentence == f"Model (culprit) raised ValueError: no such angle (LINE) {when}. {INPUTS}"


def test_the_tick_told_is_that_of_the_step_even_where_the_period_is_longer():
    sentence, rows = failure(raising(False, ValueError("late"), period=3))
    assert "in the step from t = 0.6 s, tick 6. Last inputs: omega_ref = 6 rad/s" in sentence
    assert len(rows) == 7


@step_function(NOTHING, U, (Port("y"),))
def reciprocal(m, t, h, u, y):
    y.y = 1.0 / u.u
    return 0


def test_a_division_by_zero_in_a_native_component_stops_the_run():
    memory = np.zeros(1, dtype=NOTHING)
    address = memory.ctypes.data
    culprit = Component("culprit", U, (Port("y"),), False, reciprocal.address, address, np.zeros(1), keep=memory)
    countdown = sampled("countdown", lambda t, h, u: FAILS_AT - round(t / TICK))
    simulation = Simulation(System([countdown, culprit], [("countdown.y", "culprit.u")], TICK), 20)
    with pytest.raises(ComponentFailed, match=r"culprit returned infinity for y in the step from t = 0\.5 s, tick 5\."):
        simulation.run()


@pytest.mark.parametrize("status", [2, 7, -1, -(2**31), 2**31 - 1])
def test_a_bad_status_is_told_as_a_number(status):
    sentence, _ = failure(native("culprit", status))
    assert sentence == f"culprit returned status {status} in the step from t = 0.5 s, tick 5. Last inputs: none."


def test_a_warning_does_not_stop_a_run():
    assert len(Simulation(system(native("culprit", 1)), 20).run()) == 21


@pytest.mark.parametrize("slice_ticks", [1, 5, 6, 100])
@pytest.mark.parametrize(("is_sampled", "rows_before"), [(True, FAILS_AT), (False, FAILS_AT + 1)])
def test_rows_before_a_failure_are_those_of_a_run_without_it(is_sampled, rows_before, slice_ticks):
    _, rows = failure(raising(is_sampled, ValueError("no")), slice_ticks)
    healthy = Simulation(system(failing(is_sampled, 1.0)), 20).run()
    np.testing.assert_array_equal(rows, healthy[:rows_before])


def test_a_failed_simulation_has_finished_and_run_raises_what_happened():
    simulation = Simulation(system(raising(True, ValueError("no"))), 20)
    with pytest.raises(ComponentFailed, match=r"raised ValueError: no \(\w+\.py, line \d+\) at t = 0\.5 s"):
        simulation.run()
    assert simulation.is_over
    assert simulation.next_tick == FAILS_AT


def test_nobody_is_stepped_after_the_culprit():
    culprit = raising(False, ValueError("no"))
    after = continuous("after", lambda t, h, u: 0.0)
    count = sampled("count", lambda t, h, u: round(t / TICK), outputs=(OMEGA,))
    pair = sampled("pair", lambda t, h, u: (0.0, 0.0), outputs=(PAIR,))
    wires = [("count.omega_ref", "culprit.omega_ref"), ("pair.tau", "culprit.tau")]
    simulation = Simulation(System([count, pair, culprit, after], wires, TICK), 20)
    with pytest.raises(ComponentFailed):
        simulation.run()
    assert len(after.model.calls) == FAILS_AT


def test_the_last_inputs_are_kept_for_whoever_asks():
    culprit: PythonComponent = raising(False, ValueError("no"))
    simulation = Simulation(system(culprit), 20)
    with pytest.raises(ComponentFailed):
        simulation.run()
    assert simulation.inputs(culprit).tolist() == [5.0, 0.5, -0.25]


def test_a_keyboard_interrupt_inside_a_python_component_passes_through():
    with pytest.raises(KeyboardInterrupt):
        Simulation(system(raising(False, KeyboardInterrupt())), 20).run()


def test_a_system_with_a_component_more_takes_over_where_another_one_stands():
    """The newcomer passes on what it is given: what all others do is what they do without it."""
    clocked, held = sampled("clock", clock), continuous("held", lambda t, h, u: u + 1.0, (Port("u"),))
    wired = [("clock.y", "held.u")]
    before = Simulation(System([clocked, held], wired, 0.5), 20)
    before.advance(7)
    passing = sampled("passing", echo, (Port("u"),))
    after = Simulation(System([clocked, passing, held], [("clock.y", "passing.u"), ("passing.y", "held.u")], 0.5), 20)
    assert after.copy_from(before) == ["passing"]
    after.derive_outputs(passing, lambda given: given)
    assert after.next_tick == before.next_tick == 7
    assert after.outputs(passing) == after.outputs(clocked) == before.outputs(clocked)
    rows, others = after.advance(5).copy(), before.advance(5)
    np.testing.assert_array_equal(rows[:, [0, 2]], others)


def test_what_another_component_of_its_name_remembers_is_handed_over():
    wait = [delay("wait", (Port("y"),), 3, np.zeros(1)) for _ in range(2)]
    ticking = sampled("clock", clock)
    one, other = (Simulation(System([ticking, each], [("clock.y", "wait.y")], 0.5), 20) for each in wait)
    one.advance(7)
    assert other.copy_from(one) == []
    np.testing.assert_array_equal(other.advance(5).copy(), one.advance(5))
