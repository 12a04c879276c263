"""The laws of contact against mechanics that is solved without them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.plant.states import SURFACES, share
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.plant.component import Plant, rest_state
from twin.robot.plant.contact_law import ContactLaw, elastic_force, pressing_force

over_every_law = pytest.mark.parametrize("name", sorted(SURFACES))
laws = st.sampled_from(sorted(SURFACES))
depths = st.integers(1, 10_000).map(lambda micrometres: 1e-6 * micrometres)
MASS = 0.3
TIGHT = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}


def thrown(parameters, speed):
    """Speed (m/s) at which a free mass that arrives at `speed` leaves the surface."""

    def rate(_t, state):
        depth, v = state
        return [v, -pressing_force(parameters, depth, v) / MASS]

    def left(_t, state):
        return state[0]

    left.terminal, left.direction = True, -1.0  # type: ignore[attr-defined]
    # from just inside, so that the start is not an event
    return -solve_ivp(rate, (0.0, 10.0), [1e-12, speed], events=left, **TIGHT).y[1, -1]


@pytest.mark.parametrize("name", ["Hunt-Crossley", "Hunt-Crossley, exponent 1.5", "exponential"])
@pytest.mark.parametrize("speed", [0.02, 0.1, 0.25])
def test_a_mass_rebounds_as_hunt_and_crossley_integrate_it(name, speed):
    """From m v dv/dd = -f(d) (1 + c v): v/c - ln(1 + c v)/c^2 is the same before and after, whatever f and m are."""
    c = SURFACES[name].damping

    def invariant(v):
        return c * v - np.log1p(c * v)

    expected = brentq(lambda out: invariant(-out) - invariant(speed), 0.0, speed, xtol=1e-14)
    # integration to 1e-10; the start 1 pm inside
    assert thrown(SURFACES[name], speed) == pytest.approx(expected, rel=1e-6)
    assert expected < speed


def test_a_light_impact_loses_what_hunt_and_crossley_give_for_small_speeds():
    # their restitution 1 - (2/3) c v, up to (c v)^2 = 1e-4
    assert thrown(PARAMETERS, 0.01 / 3.0) == pytest.approx((1.0 - 0.02 / 3.0) * 0.01 / 3.0, rel=1e-4)


def test_kelvin_voigt_swings_like_a_damped_oscillator():
    parameters = SURFACES["Kelvin-Voigt"]
    K, C = parameters.K, parameters.damper
    load, start = 5.0, 2e-3

    def rate(_t, state):
        return [state[1], (load - pressing_force(parameters, *state)) / MASS]

    t = np.linspace(0.0, 0.3, 50)
    # always deeper than the touch depth
    found = solve_ivp(rate, (0.0, 0.3), [load / K + start, 0.0], t_eval=t, **TIGHT).y[0]
    decay = C / (2.0 * MASS)
    omega = np.sqrt(K / MASS - decay**2)
    swing = start * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    np.testing.assert_allclose(found, load / K + swing, rtol=0, atol=1e-10)


def test_the_stiffness_of_the_exponential_law_grows_with_the_force():
    """Fung's observation is the law's differential equation: dF/dd = K + beta F."""
    parameters = SURFACES["exponential"]
    K, beta = parameters.K, parameters.stiffening
    d = np.linspace(1e-4, 0.02, 30)
    expected = solve_ivp(lambda _d, F: K + beta * F, (0.0, 0.02), [0.0], t_eval=d, **TIGHT).y[0]
    np.testing.assert_allclose([elastic_force(parameters, depth) for depth in d], expected, rtol=1e-9)


@given(st.floats(1.0, 3.0), st.floats(1e-3, 0.02))
def test_stiffness_is_the_secant_at_the_reference_depth_whatever_the_exponent(exponent, reference_depth):
    parameters = PARAMETERS._replace(exponent=exponent, reference_depth=reference_depth)
    force = pressing_force(parameters, reference_depth, 0.0)
    # rounding
    assert force == pytest.approx(parameters.K * reference_depth, rel=1e-14)


@given(st.floats(1.0, 3.0), depths)
def test_at_twice_the_depth_the_force_is_two_to_the_exponent_times_as_large(exponent, depth):
    parameters = PARAMETERS._replace(exponent=exponent, reference_depth=0.005)
    ratio = pressing_force(parameters, 2.0 * depth, 0.0) / pressing_force(parameters, depth, 0.0)
    # rounding
    assert ratio == pytest.approx(2.0**exponent, rel=1e-12)


@given(st.integers(0, 10_000).map(lambda micrometres: 1e-6 * micrometres))
def test_without_stiffening_to_speak_of_the_exponential_law_is_linear(depth):
    soft = PARAMETERS._replace(law=int(ContactLaw.EXPONENTIAL), stiffening=1e-6)
    # exp(x) - 1 - x < x^2 with x <= 1e-8
    assert pressing_force(soft, depth, 0.0) == pytest.approx(PARAMETERS.K * depth, rel=1e-8)


@given(laws, depths, share)
def test_a_surface_never_pulls(name, depth, rate):
    assert pressing_force(SURFACES[name], depth, 10.0 * rate) >= 0.0
    assert pressing_force(SURFACES[name], -depth, 10.0 * rate) == 0.0


@given(laws, depths, share)
def test_what_a_surface_does_not_store_it_takes(name, depth, rate):
    """F d_dot >= (elastic force) d_dot, the power that goes into its potential: the rest is heat, at every instant."""
    parameters = SURFACES[name]
    lost = (pressing_force(parameters, depth, rate) - elastic_force(parameters, depth)) * rate
    assert lost >= 0.0


@pytest.mark.slow
@given(laws, st.floats(0.0, 0.006), st.tuples(share, share), st.tuples(share, share), st.floats(0.5, 50.0))
def test_no_closed_cycle_of_pressing_gains_energy(name, middle, waves, phases, omega):
    """The loop of force over depth runs clockwise, also where the cycle lifts off."""
    phi = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    depth, rate = np.full_like(phi, middle), np.zeros_like(phi)
    for order, wave, phase in zip((1, 2), waves, phases, strict=True):
        depth += 0.004 * wave * np.sin(order * phi + np.pi * phase)
        rate += 0.004 * wave * order * omega * np.cos(order * phi + np.pi * phase)
    force = np.array([pressing_force(SURFACES[name], d, v) for d, v in zip(depth, rate, strict=True)])
    work = np.mean(force * rate) * 2.0 * np.pi / omega
    # J: the sum over a kink of lifting off, of order K v^2 dt^2, with 0.1 J stored at most
    assert work >= -1e-8


@given(share.map(abs))
def test_kelvin_voigt_begins_without_a_jump(speed):
    parameters = SURFACES["Kelvin-Voigt"]
    # a ten-thousandth of the touch depth deep: the damper would give up to 15 N there
    depth = 1e-4 * parameters.touch_depth
    assert pressing_force(parameters, depth, speed) <= parameters.K * depth + 1e-6


def test_kelvin_voigts_damper_is_whole_from_the_touch_depth_on():
    parameters = SURFACES["Kelvin-Voigt"]
    for depth in (parameters.touch_depth, 2.0 * parameters.touch_depth):
        # rounding
        assert pressing_force(parameters, depth, 0.1) == pytest.approx(parameters.K * depth + 1.5, rel=1e-14)
    assert parameters.law == ContactLaw.KELVIN_VOIGT


@over_every_law
def test_one_millisecond_is_enough_for_an_impact_at_100_millimetres_per_second(name):
    parameters = SURFACES[name]
    # touches in the middle of a tick
    x, theta_m = rest_state(parameters, (0.0, 0.0, parameters.z_s + 2.05e-3))
    x[5] = -0.1
    omega_m = parameters.N * jacobian(Geometry(*parameters[:4]), x[:3]) @ x[3:6]
    motors = theta_m + np.minimum(np.arange(100), 60)[:, None] * 1e-3 * omega_m

    def pressed(substeps):
        stepped = ComponentStepper(Plant(parameters, x, theta_m, substeps))
        return np.array([stepped(held, 0.0, 1e-3)[21] for held in motors])

    fine = pressed(20)
    assert fine.max() > 2.0
    # N; four times what was measured, 1.3e-4 N of 2.4 to 3.7 N
    assert np.abs(pressed(1) - fine).max() < 5e-4


@given(st.floats(0.0, 1.5), st.floats(-0.01, 0.5))
def test_a_kelvin_voigt_damper_fades_in_over_the_touch_depth(share, rate):
    """Its share s^2 (3 - 2 s) leaves zero and reaches one without a bend."""
    soft = SURFACES["Kelvin-Voigt"]
    d = share * soft.touch_depth
    s = min(share, 1.0)
    expected = soft.K * d + soft.damper * (3.0 * s**2 - 2.0 * s**3) * rate
    # rounding of sums below 10 N
    assert pressing_force(soft, d, rate) == pytest.approx(max(expected, 0.0), rel=1e-12, abs=1e-14)
