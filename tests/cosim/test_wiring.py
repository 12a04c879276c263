from hypothesis import given
from hypothesis import strategies as st

from tests.cosim.models import sampled
from twin.cosim.port import Port
from twin.cosim.system import System
from twin.cosim.wiring import End, ends, wires

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
