"""Interpolated inputs and repeated steps, on a mass and a spring in two components whose motion is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.cosim.component import Component, NativeComponent, step_function
from twin.kernel.cosim.interpolation import input_weights
from twin.kernel.cosim.port import Port, record, state
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused

OMEGA = 2.0
MEMORY = record(x=state("f8"), v=state("f8"))


FORCE, SPEED, PLACE = Port("force"), Port("v"), Port("x")


@step_function(MEMORY, (FORCE,), (PLACE, SPEED))
def _mass_step(m, t, h, u, y):
    # exact for a force that is constant over the step, as an FMU's own solver would be
    m.x += h * m.v + 0.5 * h * h * u.force
    m.v += h * u.force
    y.x, y.v = m.x, m.v
    return 0


@step_function(MEMORY, (SPEED,), (FORCE,))
def _spring_step(m, t, h, u, y):
    # it knows the speed at its end only; its length is what it adds up
    m.x += h * u.v
    y.force = -4.0 * m.x
    return 0


def mass() -> NativeComponent:
    memory = np.array([(1.0, 0.0)], dtype=MEMORY)
    return NativeComponent("mass", (FORCE,), (PLACE, SPEED), False, _mass_step, memory, np.array([1.0, 0.0]))


def mass_that_cannot_go_back() -> Component:
    one = mass()
    return Component(
        "mass", one.inputs, one.outputs, False, one.step_address, one.self_address, one.initial_outputs, keep=one
    )


def spring(period: int = 1) -> NativeComponent:
    memory = np.array([(1.0, 0.0)], dtype=MEMORY)
    return NativeComponent("spring", (SPEED,), (FORCE,), False, _spring_step, memory, np.array([-4.0]), period)


def largest_error(steps: int, **coupling) -> float:
    """Of x over 3 s against cos(2 t)."""
    system = System(
        [mass(), spring()], [("mass.v", "spring.v"), ("spring.force", "mass.force")], 3.0 / steps, **coupling
    )
    x = Simulation(system, steps).run()[:, system.columns("mass.x").start]
    return float(np.abs(x - np.cos(OMEGA * np.linspace(0.0, 3.0, steps + 1))).max())


def order(**coupling) -> float:
    errors = [largest_error(steps, **coupling) for steps in (200, 400, 800)]
    return float(np.polyfit(np.log([1.0, 0.5, 0.25]), np.log(errors), 1)[0])


@pytest.mark.parametrize(
    ("scheme", "inputs", "iterations", "expected"),
    [
        # held inputs in Gauss-Seidel order happen to be the leap-frog method here, of order 2 without losses
        ("jacobi", "hold", 1, 1.0),
        ("jacobi", "linear", 1, 2.0),
        ("gauss_seidel", "linear", 1, 2.0),
        ("gauss_seidel", "linear", 3, 2.0),
    ],
)
def test_held_inputs_are_of_order_one_and_interpolated_ones_of_order_two(scheme, inputs, iterations, expected):
    # the next order's share of the error at 200 steps, a hundredth, moves the slope by less than a tenth of this
    assert order(scheme=scheme, inputs=inputs, iterations=iterations) == pytest.approx(expected, abs=0.15)


def test_repeated_steps_make_both_schemes_the_same():
    jacobi, seidel = (largest_error(100, scheme=s, inputs="linear", iterations=12) for s in ("jacobi", "gauss_seidel"))
    # both have converged to the implicit midpoint rule: each repetition gains a factor of omega^2 h^2 / 4 = 1e-3
    assert jacobi == pytest.approx(seidel, rel=1e-9)


def test_a_converged_step_keeps_the_energy_that_a_held_input_creates():
    def energy_gain(**coupling) -> float:
        system = System([mass(), spring()], [("mass.v", "spring.v"), ("spring.force", "mass.force")], 0.03, **coupling)
        x, v = Simulation(system, 1000).run()[-1, system.columns("mass.x").start :][:2]
        return float(0.5 * v**2 + 0.5 * OMEGA**2 * x**2) / (0.5 * OMEGA**2) - 1.0

    assert energy_gain(scheme="jacobi") > 1.0
    # the implicit midpoint rule conserves what is quadratic: rounding of 1000 steps
    assert energy_gain(inputs="linear", iterations=20) == pytest.approx(0.0, abs=1e-9)


@given(st.sampled_from(["start", "middle", "end"]), st.booleans(), st.sampled_from(["hold", "linear"]))
def test_a_signal_that_does_not_change_is_passed_on_as_it_is(instant, seen, inputs):
    weights = input_weights(Port("u", instant=instant), seen, inputs)
    assert np.array_equal(weights.sum(axis=1), [1.0, 1.0])


@given(st.sampled_from(["start", "middle", "end"]), st.booleans(), st.floats(-3.0, 3.0))
def test_a_ramp_is_met_exactly_at_the_instant_of_the_port(instant, seen, rate):
    valid, newest, before = 0.0, rate, -rate
    weights = input_weights(Port("u", instant=instant), seen, "linear")
    at = {"start": 0.0, "middle": 0.5, "end": 1.0}[instant]
    np.testing.assert_allclose(weights @ [valid, newest, before], at * rate, atol=1e-15)


def test_what_cannot_go_back_or_does_not_step_every_tick_is_refused_by_name():
    wires = [("mass.v", "spring.v"), ("spring.force", "mass.force")]
    with pytest.raises(InputRefused, match="mass: cannot go back to the start of a step, which iterations = 2 needs"):
        System([mass_that_cannot_go_back(), spring()], wires, 0.01, iterations=2)
    with pytest.raises(InputRefused, match="spring: steps every 2 ticks; interpolated inputs"):
        System([mass(), spring(period=2)], wires, 0.01, inputs="linear")


def test_a_sampled_output_is_held_whatever_is_interpolated():
    class Stairs:
        inputs, outputs, sampled = (), (Port("force"),), True

        def step(self, t, h, u, y):
            y[0] = 1.0 if t > 0.045 else 0.0

    system = System(
        [PythonComponent("stairs", Stairs()), mass()], [("stairs.force", "mass.force")], 0.01, inputs="linear"
    )
    v = Simulation(system, 10).run()[:, system.columns("mass.v").start]
    # from tick 5 on
    np.testing.assert_allclose(v, np.maximum(0.0, 0.01 * (np.arange(11) - 5)), atol=1e-15)
