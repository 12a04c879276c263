"""Systems from Python are those of the command, bit for bit; they can be asked, set, saved and observed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.docs.code_blocks import blocks
from tests.kernel.systems.archives import component, connection, line, structure, system, values
from tests.kernel.systems.conftest import Ran
from twin.kernel.cosim.port import Port
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.systems.additions import Additions

SERVO, MOTOR = "fmus/velocity_servo/velocity_servo.fmu", "fmus/pmsm_foc/pmsm_foc.fmu"
WIRES = [("leader.omega_m", "follower.omega_ref"), ("follower.tau_motor", "leader.tau_load")]
Coupled = Callable[..., twin.Cosimulation]


class Gain:
    """Twice what it gets, at the end of the step."""

    inputs = (Port("u", 1, "rad/s"),)
    outputs = (Port("y", 1, "rad/s"),)
    sampled = False

    def step(self, t, h, u, y):
        y[0] = 2.0 * u[0]


@pytest.fixture
def coupled(root: Path) -> Coupled:
    """A servo and a motor that follows it, not yet running."""

    def make(between: Gain | None = None, **asked) -> twin.Cosimulation:
        cosim = twin.Cosimulation(tick=1e-3, stop=0.2, **asked)
        cosim.load("leader", root / SERVO, omega_ref=2.0)
        if between is not None:
            cosim.add("gain", between)
        cosim.load("follower", root / MOTOR)
        wires = WIRES if between is None else [(WIRES[0][0], "gain.u"), ("gain.y", WIRES[0][1]), WIRES[1]]
        for wire in wires:
            cosim.wire(*wire)
        return cosim

    return make


def archived(root: Path, inside: str = "") -> tuple[str, dict[str, Path]]:
    """The same as an SSP."""
    parts = [component("leader", "s.fmu", bindings=values("omega_ref=2")), component("follower", "m.fmu")]
    wires = [connection(*WIRES[0], inside), connection(*WIRES[1])]
    return structure(system(parts, wires), 0.2), {"s.fmu": root / SERVO, "m.fmu": root / MOTOR}


@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
def test_two_fmus_give_the_bits_of_the_command(coupled: Coupled, ran: Ran, root: Path, scheme):
    recording, _ = ran(*archived(root), tick=1e-3, scheme=scheme)
    with coupled(scheme=scheme) as cosim:
        series = cosim.observe()
        cosim.run()
    np.testing.assert_allclose(series.t, recording.time("leader"), atol=1e-12)
    for key in recording.fields():
        np.testing.assert_array_equal(series[key], recording[key])


def test_a_component_in_python_gives_the_bits_of_what_it_stands_for(coupled: Coupled, ran: Ran, root: Path):
    recording, _ = ran(*archived(root, line(2.0)), tick=1e-3)
    with coupled(Gain()) as cosim:
        series = cosim.observe("follower.*", "gain.y")
        cosim.run()
        assert cosim.get("gain.y") == series["gain.y"][-1]
    for key in ("follower.omega_m", "follower.tau_motor"):
        np.testing.assert_array_equal(series[key], recording[key])


def test_examples_of_the_page_are_as_short_as_asked_and_give_the_bits_of_the_command(
    ran: Ran, root: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(root)
    two, between, *_ = (block.text for block in blocks(root, "docs/ssp.md") if block.language == "python")
    assert len(two.splitlines()) <= 15 and len(between.splitlines()) <= 25
    names: dict[str, Any] = {}
    exec(two, names)
    exec(between, names)
    for series, inside in ((names["seen"], ""), (names["turned"], line(2.0))):
        recording, _ = ran(*archived(root, inside), tick=1e-3, stop=1.0)
        for key in series.names:
            np.testing.assert_array_equal(series[key], recording[key])


def test_a_system_of_a_file_gives_the_bits_of_the_command(ran: Ran, root: Path, tmp_path: Path):
    additions = Additions(["leader.T_m=0.02"], inputs=["leader.omega_ref=sin(20*t)"])
    recording, _ = ran(*archived(root), tick=1e-3, additions=additions)
    with twin.Cosimulation.read(tmp_path / "1.ssp", tick=1e-3) as cosim:
        cosim.set("leader.T_m", 0.02)
        cosim.feed("leader.omega_ref", "sin(20*t)")
        series = cosim.observe("*.omega_m")
        cosim.run()
        assert cosim.t == 0.2
    np.testing.assert_array_equal(series["follower.omega_m"], recording["follower.omega_m"])


def test_it_goes_on_as_it_would_have_from_a_state_and_what_is_observed_has_each_tick_once(coupled: Coupled):
    with coupled() as cosim:
        series = cosim.observe("follower.omega_m")
        cosim.step(70)
        state, there = cosim.state(), cosim.get("follower.omega_m")
        cosim.step(130)
        first = series["follower.omega_m"].copy()
        cosim.restore(state)
        assert cosim.get("follower.omega_m") == there and cosim.t == pytest.approx(0.07)
        cosim.step(130)
        np.testing.assert_array_equal(series["follower.omega_m"], first)
        np.testing.assert_allclose(series.t, 1e-3 * np.arange(200), atol=1e-15)


def test_an_input_that_nothing_feeds_holds_what_it_is_set_to(root: Path):
    with twin.Cosimulation(tick=1e-3, stop=1.0) as cosim:
        cosim.load("shaft", root / "fmus/ideal_velocity/ideal_velocity.fmu", {"theta_m": 0.5})
        cosim.set("shaft.omega_ref", 1.0)
        cosim.step()
        assert cosim.get("shaft.omega_m") == 1.0 and cosim.get("shaft.theta_m") == 0.501
        cosim.set("shaft.omega_ref", -3.0)
        cosim.step(2)
        assert cosim.get("shaft.omega_m") == -3.0 == cosim.get("shaft.omega_ref")


def test_what_python_raises_ends_the_run_and_what_was_seen_stays(coupled: Coupled):
    class Broken(Gain):
        def step(self, t, h, u, y):
            if t > 0.0495:
                raise ValueError("enough")
            super().step(t, h, u, y)

    with coupled(Broken()) as cosim:
        series = cosim.observe("leader.omega_m")
        with pytest.raises(ComponentFailed, match=r"Broken \(gain\) raised ValueError: enough .* tick 50"):
            cosim.run()
        assert len(series.t) == 51


BAD = {
    "no file": (lambda c, r: c.load("a", "none.fmu"), "none.fmu: no such FMU"),
    "a name": (lambda c, r: c.load("a.b", r / SERVO), "'a.b': expected a name of letters, digits and _"),
    "a name twice": (lambda c, r: c.load("leader", r / SERVO), "two components are called 'leader'"),
    "a value": (lambda c, r: (c.set("leader.T_n", 1.0), c.step()), "leader has no variable 'T_n'; did you mean 'T_m'?"),
    "a bound": (lambda c, r: (c.set("leader.T_m", -1.0), c.step()), "parameter T_m = -1: expected"),
    "a wire": (lambda c, r: (c.wire("leder.omega_m", "follower.omega_ref"), c.step()), "did you mean 'leader'?"),
    "a variable": (lambda c, r: c.get("leader.omega"), "leader has no variable 'omega'; did you mean"),
    "no component": (lambda c, r: c.get("leder.omega_m"), "'leder.omega_m': no such component; did you mean 'leader'?"),
    "fed": (lambda c, r: (c.step(), c.set("leader.tau_load", 1.0)), "leader.tau_load is fed by a connection"),
    "not tunable": (lambda c, r: (c.step(), c.set("leader.T_m", 1.0)), "leader.T_m is a fixed parameter; inputs and"),
    "too far": (lambda c, r: c.step(202), "202 steps at t = 0 s; expected 1 .. 201, until stop"),
    "no pattern": (lambda c, r: c.observe("*.omega"), "no output is called *.omega; did you mean"),
    "too late": (lambda c, r: (c.step(), c.wire(*WIRES[0])), "the system runs already; give it its wires before"),
    "no end": (lambda c, r: (twin.Cosimulation(tick=1e-3).step()), "no end is given; expected stop=SECONDS"),
    "a factor": (
        lambda c, r: (c.add("gain", Gain()), c.wire("gain.y", "follower.omega_ref", 2.0), c.step()),
        "apply it in the Python component",
    ),
    "units": (
        lambda c, r: (c.add("gain", Gain()), c.wire("leader.theta_m", "gain.u"), c.step()),
        "from leader.theta_m in 'rad' to gain.u in 'rad/s'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
def test_what_cannot_be_done_is_refused_in_a_sentence(bad: str, coupled: Coupled, root: Path):
    act, told = BAD[bad]
    with coupled() as cosim, pytest.raises(InputRefused) as refused:
        act(cosim, root)
    assert told in str(refused.value)
