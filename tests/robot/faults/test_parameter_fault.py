import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.cosim.models import sampled
from tests.laws.runs import PARAMETERS as REAL
from tests.robot.faults.robot import COUNTS, SPEED_LIMIT, TICK, joined, plant, run
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System, wires
from twin.robot.assembly.declared import FAULT_PLACES
from twin.robot.assembly.inject import inject
from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK, Fault
from twin.robot.plant.component import Plant, rest_state

ONSET, END, LAST = 40, 80, 120
NOMINAL = {
    "k_s_share": (1.0, 0.7, 1.1),
    "backlash_added": (0.0, 0.1, 0.2),
    "slip": (0.0, 0.1, 0.2),
    "b_j_added": (0.0, 0.3, 0.1),
    "K": (1250.0,) * 3,
    "k_s": (1.0,) * 3,
    "eta": (0.9,) * 3,
}
CASES = [(kind, f"joint_{i}", i - 1) for kind in FAULT_PLACES for i in (1, 2, 3) if FAULT_PLACES[kind].field in NOMINAL]
CASES = [
    (kind, {"K": "contact", "k_s": "estimator", "eta": "estimator"}.get(FAULT_PLACES[kind].field, joint), i)
    for kind, joint, i in CASES
]


@pytest.mark.parametrize(("kind", "target", "joint"), CASES)
def test_the_parameter_has_the_stated_value_in_the_window_and_exactly_the_nominal_one_outside(kind, target, joint):
    magnitude = 0.0 if kind == "spring_broken" else 0.3
    value = run(Fault(kind, target, ONSET, END, magnitude), last_tick=LAST)["fault_1.value"][:, 0]
    nominal = NOMINAL[FAULT_PLACES[kind].field][joint]
    faulty = nominal * magnitude if FAULT_KINDS[kind].unit in ("factor", None) else nominal + magnitude
    # 1 + (0.3 - 1) rounds once
    np.testing.assert_allclose(value[ONSET:END], faulty, rtol=1e-15)
    np.testing.assert_array_equal(value[:ONSET], nominal)
    np.testing.assert_array_equal(value[END:], nominal)


@pytest.mark.parametrize(("kind", "target", "joint"), CASES)
def test_the_owner_has_the_value_in_the_very_tick_in_which_the_fault_tells_it(kind, target, joint):
    done = run(Fault(kind, target, ONSET, END, 0.3), last_tick=LAST)
    place = FAULT_PLACES[kind]
    had = done[f"{place.component}.{place.field}"]
    value = done["fault_1.value"][:, 0]
    if place.component == "plant":
        # the plant's row shows the step that began one tick before
        np.testing.assert_array_equal(had[1:, joint % had.shape[1]], value[:-1])
    else:
        np.testing.assert_array_equal(had[::2, 0], value[::2])
    others = [i for i in range(had.shape[1]) if i != joint % had.shape[1]]
    np.testing.assert_array_equal(had[1:, others], np.tile(np.array(NOMINAL[place.field])[others], (LAST, 1)))


def test_after_the_run_of_a_passing_fault_the_memory_is_what_it_was():
    before = plant().memory.tobytes()
    done = run(Fault("spring_softened", "joint_2", ONSET, END, 1.0 / 3.0))
    assert done.system.component("plant").memory.tobytes() == before  # type: ignore[attr-defined]


def test_a_ramp_grows_evenly_from_the_nominal_value():
    fault = Fault("backlash_growth", "joint_1", ONSET, NO_END_TICK, 0.5, ramp=20)
    value = run(fault, last_tick=LAST)["fault_1.value"][:, 0]
    expected = 0.5 * np.clip((np.arange(LAST + 1) - ONSET) / 20, 0.0, 1.0)
    # two roundings of numbers below 1
    np.testing.assert_allclose(value, expected, atol=1e-15)


def test_a_joint_that_gets_play_at_rest_lets_go_of_its_load_and_sinks_until_the_spring_carries_it_again():
    """At once the play takes its share of the deflection; the motors stand, so the joint follows by play/N."""
    play, onset, home = np.radians(0.5), 10, (0.0, 0.0, -0.090)
    x, theta_m = rest_state(REAL, home)
    held = sampled("held", lambda t, h, u: theta_m, outputs=(Port("theta_m", 3, "rad"),))
    growth = [Fault("backlash_growth", f"joint_{leg}", onset, NO_END_TICK, play) for leg in (1, 2, 3)]
    parts = [held, Plant(REAL, x, theta_m)]
    feeds = joined(parts, [("held.theta_m", "plant.theta_m")])
    components, feeds = inject(parts, feeds, growth, TICK, COUNTS, SPEED_LIMIT)
    system = System(components, wires(feeds, components), TICK)
    rows = Simulation(system, 3000).run()
    tau_l, theta_l = (rows[:, system.columns(f"plant.{name}")] for name in ("tau_l", "theta_l"))
    np.testing.assert_array_equal(tau_l[onset], tau_l[0])
    # within the first tick nothing has moved by more than a t^2/2, 1 um
    lost = REAL.k_s * REAL.N * REAL.eta * play
    np.testing.assert_allclose(np.abs(tau_l[0]) - np.abs(tau_l[onset + 1]), lost, rtol=0.02)
    # as deflected as before but for the weight, which pulls a little less in the lower pose
    worn = REAL._replace(backlash_added=(play, play, play))
    end = rows[-1, system.columns("plant.p_B")]
    np.testing.assert_allclose(rest_state(worn, end)[1], theta_m, rtol=0, atol=1e-9)
    np.testing.assert_allclose(theta_l[-1] - theta_l[0], play / REAL.N, rtol=0.02)
    assert end[2] < home[2]


windows = st.tuples(st.integers(0, 30), st.integers(1, 30)).map(lambda w: (w[0], w[0] + w[1]))


@given(windows, windows)
def test_two_faults_on_one_parameter_multiply_while_both_are_active(one, two):
    half = Fault("spring_softened", "joint_1", one[0], one[1], 0.5)
    quarter = Fault("spring_softened", "joint_1", two[0], two[1], 0.25)
    value = run(half, quarter, last_tick=70)["fault_2.value"][:, 0]
    k = np.arange(71)
    expected = np.where((k >= one[0]) & (k < one[1]), 0.5, 1.0) * np.where((k >= two[0]) & (k < two[1]), 0.25, 1.0)
    # powers of two
    np.testing.assert_array_equal(value, expected)
