"""What a system refuses before anything runs, and the sentence it says."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.cosim.models import Part, continuous, echo, sampled
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.system import End, System, ends, wires
from twin.kernel.errors import InputRefused

SIZES = (1, 2, 3)


def parts():
    """A component that puts out what another one takes, both with ports of several sizes."""
    ports = tuple(Port(f"p{size}", size) for size in SIZES)
    zeros = [0.0] * sum(SIZES)
    return [
        sampled("giver", lambda t, h, u: zeros, outputs=ports),
        sampled("taker", lambda t, h, u: zeros, ports, outputs=ports),
    ]


def test_the_ends_of_a_port_are_its_values_in_order():
    assert ends(parts(), "output", "p2") == [
        End("giver", "p2", 0),
        End("giver", "p2", 1),
        *ends(parts()[1:], "output", "p2"),
    ]
    assert ends(parts(), "input", "p3") == [End("taker", "p3", i) for i in range(3)]
    assert ends(parts(), "input", "nothing") == []


def test_ports_that_feed_each_other_as_a_whole_are_one_wire():
    feeds = {End("taker", f"p{size}", i): End("giver", f"p{size}", i) for size in SIZES for i in range(size)}
    assert wires(feeds, parts()) == [(f"giver.p{size}", f"taker.p{size}") for size in SIZES]


@given(st.permutations(ends(parts()[:1], "output", "p3") + ends(parts()[:1], "output", "p2")[:1]), st.randoms())
def test_a_system_of_these_wires_feeds_every_value_as_was_said(sources, draw):
    components = parts()
    targets = [end for size in SIZES for end in ends(components, "input", f"p{size}")]
    feeds = {target: draw.choice(sources) for target in targets}
    system = System(components, wires(feeds, components), 1e-3)
    told = {end: system.columns(f"giver.{end.port}[{end.element}]").start for end in sources}
    assert list(system.sources) == [told[feeds[target]] for target in targets]


TORQUE = (Port("tau_load", 3),)


def system_parts() -> list[Part]:
    plant = continuous("plant", lambda t, h, u: (0.0, 0.0, 0.0), (Port("theta_m"),), outputs=TORQUE)
    return [plant, continuous("drive", echo, (Port("load"),), outputs=(Port("theta_m"),))]


GOOD = [("plant.tau_load[0]", "drive.load"), ("drive.theta_m", "plant.theta_m")]


def refusal(components: list[Part], wires: list[tuple[str, str]]) -> str:
    with pytest.raises(InputRefused) as refused:
        System(components, wires, 1e-3)
    return str(refused.value)


@pytest.mark.parametrize(
    ("wire", "sentence"),
    [
        (
            ("plamt.tau_load[0]", "drive.load"),
            "wire end 'plamt.tau_load[0]': no component 'plamt'; did you mean 'plant'?",
        ),
        (
            ("plant.tau_laod[0]", "drive.load"),
            "wire end 'plant.tau_laod[0]': plant has no output 'tau_laod'; did you mean 'tau_load'?",
        ),
        (
            ("plant.tau_load[0]", "drive.laod"),
            "wire end 'drive.laod': drive has no input 'laod'; did you mean 'load'?",
        ),
        (("xyz.y", "drive.load"), "wire end 'xyz.y': no component 'xyz'; there are plant, drive"),
        (
            ("plant.theta_m", "drive.load"),
            "wire end 'plant.theta_m': plant has no output 'theta_m'; there are tau_load",
        ),
        (("plant.tau_load", "drive.load"), "wire plant.tau_load -> drive.load: 3 values into 1"),
        (
            ("plant.tau_load[3]", "drive.load"),
            "wire end 'plant.tau_load[3]': tau_load has 3 values, counted from 0",
        ),
        (
            ("plant.tau_load[-1]", "drive.load"),
            "wire end 'plant.tau_load[-1]': expected component.port or component.port[index]",
        ),
        (("plant", "drive.load"), "wire end 'plant': expected component.port or component.port[index]"),
    ],
)
def test_a_wrong_wire_is_refused_with_what_was_meant(wire, sentence):
    assert refusal(system_parts(), [wire, GOOD[1]]) == sentence


def test_an_input_takes_one_wire_only():
    twice = [*GOOD, ("plant.tau_load[1]", "drive.load")]
    assert refusal(system_parts(), twice) == "input drive.load is fed by two wires; remove one (plant.tau_load[1])"


def test_an_element_of_an_input_takes_one_wire_only():
    source = sampled("a", lambda t, h, u: (0.0, 0.0, 0.0), outputs=TORQUE)
    sink = sampled("b", lambda t, h, u: 0.0, TORQUE)
    twice = [("a.tau_load", "b.tau_load"), ("a.tau_load[0]", "b.tau_load[2]")]
    assert refusal([source, sink], twice) == "input b.tau_load[2] is fed by two wires; remove one (a.tau_load[0])"


@pytest.mark.parametrize("missing", [0, 1])
def test_an_input_needs_a_wire(missing):
    end = GOOD[missing][1]
    assert refusal(system_parts(), [GOOD[1 - missing]]) == f"input {end} has no wire; connect an output to it"


def test_an_input_needs_a_wire_for_each_of_its_elements():
    source = sampled("a", lambda t, h, u: (0.0, 0.0, 0.0), outputs=TORQUE)
    sink = sampled("b", lambda t, h, u: 0.0, TORQUE)
    two_of_three = [("a.tau_load[0]", "b.tau_load[0]"), ("a.tau_load[1]", "b.tau_load[2]")]
    assert refusal([source, sink], two_of_three) == "input b.tau_load has no wire; connect an output to it"


def test_components_have_names_of_their_own():
    twins = [sampled("a", lambda t, h, u: 0.0), continuous("a", lambda t, h, u: 0.0)]
    assert refusal(twins, []) == "two components are called 'a'; give each a name of its own"


def test_ports_of_a_component_have_names_of_their_own():
    part = sampled("a", lambda t, h, u: (0.0, 0.0), outputs=(Port("y"), Port("y")))
    assert refusal([part], []) == "a: two ports are called 'y'; give each its own name"


def test_a_period_is_at_least_one_tick():
    part = sampled("a", lambda t, h, u: 0.0, period=0)
    assert refusal([part], []) == "a: period 0; expected at least 1 tick"


def test_every_output_needs_an_initial_value():
    part = sampled("a", lambda t, h, u: (0.0,) * 3, outputs=TORQUE, initial_outputs=[0.0, 0.0])
    assert refusal([part], []) == "a: 2 initial outputs; its ports need 3"


def test_columns_and_components_are_found_by_name():
    system = System(system_parts(), GOOD, 1e-3)
    assert system.columns("plant.tau_load") == slice(0, 3)
    assert system.columns("plant.tau_load[1]") == slice(1, 2)
    assert system.columns("drive.theta_m") == slice(3, 4)
    assert system.component("drive").name == "drive"
    with pytest.raises(InputRefused, match=r"no component 'drvie'; did you mean 'drive'\?"):
        system.component("drvie")
