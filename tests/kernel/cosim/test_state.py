"""States of systems: in memory, as bytes, of Python classes; and bytes that are none."""

import json
import struct
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import Component, NativeComponent, doubles_at, step_function
from twin.kernel.cosim.delay import delay
from twin.kernel.cosim.port import Port, memory_of, record, state, state_fields
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedPiece, SavedState, decode_json, encode_json, stateless_reasons
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused

X, U = Port("x"), Port("u")
MEMORY = record(rate="f8", x=state("f8"), place=state("i8", below="count"), count="i8", table=state("i8"))


@step_function(MEMORY, (U,), (X,))
def _step(m, t, h, u, y):
    table = carray(doubles_at(m.table), m.count)
    table[m.place] += u.u
    m.place = (m.place + 1) % m.count
    m.x += h * (m.rate + table[m.place])
    y.x = m.x
    return 0


def grower(rate: float = 1.0, name: str = "grower") -> NativeComponent:
    table = np.zeros(3)
    memory = memory_of(MEMORY, rate=rate, count=len(table))
    return NativeComponent(name, (U,), (X,), False, _step, memory, pointers={"table": table})


class Counter:
    """How often it was stepped, as a class of a user has it."""

    inputs, outputs, sampled = (), (U,), True

    def __init__(self) -> None:
        self.count = 0

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        self.count += 1
        y[0] = self.count

    def state(self) -> dict[str, Any]:
        return {"count": self.count}

    def restore(self, state: dict[str, Any]) -> None:
        self.count = state["count"]


class Forgetful(Counter):
    """The same without a state."""

    state = restore = None  # type: ignore[assignment]


class Broken(Counter):
    """Its state cannot be had."""

    def state(self) -> dict[str, Any]:
        raise ValueError("not now")


def system(model: Counter | None = None, *more: Component, rate: float = 1.0) -> System:
    return System(
        [PythonComponent("counter", model or Counter()), grower(rate), *more], [("counter.u", "grower.u")], 0.1
    )


def saved_at(tick: int) -> SavedState:
    simulation = Simulation(system(), 100, tick)
    simulation.advance()
    return simulation.state().saved(of="this test")


def test_fields_of_a_state_are_found_in_records_in_records():
    inner = record(a="f8", b=state("3f8"))
    outer = record(one=inner, several=(inner, (2,)), whole=state(inner), c=state("i8", below="/n"), n="i8")
    assert [one.name for one in state_fields(outer)] == ["one.b", "several.b", "whole", "c"]
    # what is marked is laid out as what is not
    assert outer == record(
        one=record(a="f8", b="3f8"),
        several=(record(a="f8", b="3f8"), (2,)),
        whole=record(a="f8", b="3f8"),
        c="i8",
        n="i8",
    )


def test_a_simulation_goes_back_as_often_as_it_likes_and_forward_again():
    simulation = Simulation(system(), 30, 10)
    simulation.advance()
    state = simulation.state()
    once = simulation.advance().copy()
    for _ in range(3):
        simulation.restore(state)
        assert simulation.next_tick == 10
        np.testing.assert_array_equal(simulation.advance(), once)


def test_a_state_goes_through_bytes_with_what_is_said_about_it():
    saved = saved_at(12)
    again = SavedState.from_bytes(saved.to_bytes(), "here")
    assert again == saved and again.about == {"of": "this test"} and again.tick == 12
    simulation, whole = Simulation(system(), 30, 40), Simulation(system(), 30, 40).advance()
    simulation.restore(again)
    np.testing.assert_array_equal(simulation.advance(), whole[12:])


def test_a_state_of_another_simulation_is_refused_and_what_it_saves_is_not():
    one, other = Simulation(system(), 30, 5), Simulation(system(), 30, 5)
    one.advance()
    state = one.state()
    with pytest.raises(InputRefused, match="the state was taken in another simulation"):
        other.restore(state)
    other.restore(state.saved())
    np.testing.assert_array_equal(one.advance(), other.advance())


def test_a_class_without_a_state_is_named_and_one_that_fails_is_quoted():
    assert stateless_reasons(system(Forgetful()).components) == [
        "Forgetful (counter) is a Python class without state() and restore()"
    ]
    with pytest.raises(InputRefused, match="is a Python class without state"):
        Simulation(system(Forgetful()), 10).state()
    with pytest.raises(ComponentFailed, match=r"Broken: state\(\) raised ValueError: not now"):
        Simulation(system(Broken()), 10).state()


def test_a_component_that_says_nothing_has_no_state():
    own = Component("own", (), (), True, 0, 0, np.zeros(0))
    assert stateless_reasons([own]) == ["own does not declare what its steps change"]


def test_constants_are_no_state():
    saved = saved_at(10)
    faster = Simulation(system(rate=5.0), 30, 1)
    faster.restore(saved)
    before = faster.outputs(faster.system.component("grower"))[0]
    after = faster.advance()[0]
    assert faster.system.component("grower").memory["rate"][0] == 5.0  # type: ignore[attr-defined]
    assert after[0] == 11.0 and before > 0.0


def test_a_system_with_more_components_adopts_a_state_name_by_name():
    more = delay("late", (U,), 2, np.zeros(1))
    wires = [("counter.u", "grower.u"), ("counter.u", "late.u")]
    larger = System([PythonComponent("counter", Counter()), more, grower()], wires, 0.1)
    simulation, smaller = Simulation(larger, 30, 5), Simulation(system(), 30, 10)
    smaller.advance()
    assert simulation.adopt(smaller.state().saved()) == ["late"]
    place = larger.columns("grower.x")
    np.testing.assert_array_equal(
        simulation.advance()[:, place], smaller.advance()[:5, smaller.system.columns("grower.x")]
    )


def test_a_system_of_other_components_refuses_a_state_and_says_what_fits_nothing():
    wires = [("counter.u", "grower.u"), ("counter.u", "second.u")]
    larger = System([PythonComponent("counter", Counter()), grower(), grower(name="second")], wires, 0.1)
    with pytest.raises(InputRefused, match=r"it has nothing of that name for second.outputs \(<f8 \[1, 1\]\)"):
        Simulation(larger, 30).restore(saved_at(5))
    bigger = Simulation(larger, 30, 5)
    bigger.advance()
    with pytest.raises(
        InputRefused, match=r"the state is of another system: second\.outputs, second\.inputs, second\.x fit"
    ):
        Simulation(system(), 30).restore(bigger.state().saved())


def forged(saved: SavedState, component: str, name: str, value: np.ndarray) -> SavedState:
    """`saved` with another piece."""
    pieces = [
        SavedPiece(*piece.form, value.tobytes()) if piece.form[:2] == (component, name) else piece
        for piece in saved.pieces
    ]
    return SavedState(saved.tick, pieces, saved.inside, saved.about)


def test_an_index_that_leads_beyond_its_array_is_refused():
    bad = forged(saved_at(5), "grower", "place", np.array([7]))
    with pytest.raises(InputRefused, match=r"grower.place = 7: is outside its number of elements"):
        Simulation(system(), 30).restore(bad)


def test_an_output_that_could_never_have_been_recorded_is_refused():
    bad = forged(saved_at(5), "grower", "outputs", np.array([np.nan]))
    with pytest.raises(InputRefused, match="the state has NaN or infinity in the outputs of grower"):
        Simulation(system(), 30).restore(bad)


def written(front: object, rest: bytes = b"") -> bytes:
    text = json.dumps(front).encode()
    return zstandard.compress(struct.pack("<Q", len(text)) + text + rest)


FRONT = {"version": 1, "tick": 3, "pieces": [], "inside": [], "about": {}}


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "does not decompress"),
        (b"no state at all", "does not decompress"),
        (saved_at(4).to_bytes()[:-9], "does not decompress|damaged"),
        (zstandard.compress(b"x"), "a state of 1 bytes"),
        (zstandard.compress(bytes(8) + b"{"), "the state's description"),
        (written([]), "not a state that twin saved"),
        (written({**FRONT, "version": 2}), "a state of version 2; this twin reads 1"),
        (written({**FRONT, "tick": -1}), "tick -1"),
        (written({**FRONT, "tick": "now"}), "tick 'now'"),
        (written({**FRONT, "about": 3}), "not a state that twin saved"),
        (written({**FRONT, "pieces": [["a", "b", "<f8", [2], 16]]}, bytes(8)), "damaged: a.b"),
        (written({**FRONT, "pieces": [["a", "b", "<f8", [-1], 8]]}, bytes(8)), "damaged: a.b"),
        *(
            (written({**FRONT, "pieces": [["a", "b", kind, [1], 8]]}, bytes(8)), "not a state that twin saved")
            for kind in ("nonsense", "<f3", "<?8", "<d3", "<f0", "|O8", "<U2", "<M8", "=f8 ")
        ),
    ],
)
def test_bytes_that_are_no_state_are_refused_in_a_sentence(content: bytes, sentence: str):
    with pytest.raises(InputRefused, match=sentence) as refusal:
        SavedState.from_bytes(content, "run.mcap")
    assert str(refusal.value).startswith("run.mcap: ")


def test_a_bomb_is_refused_before_it_is_unpacked():
    bomb = zstandard.compress(bytes(80 * 2**20))
    with pytest.raises(InputRefused, match="a state of 83886080 bytes; expected 8 to 67108864"):
        SavedState.from_bytes(bomb, "run.mcap")


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


@given(values)
def test_what_json_says_of_a_value_is_that_value(value: Any):
    assert decode_json(json.loads(json.dumps(encode_json(value))), "here") == value


@given(st.lists(st.floats(), max_size=5))
def test_arrays_come_back_bit_for_bit(numbers: list[float]):
    array = np.array(numbers)
    again = decode_json(json.loads(json.dumps(encode_json(array))), "here")
    assert again.tobytes() == array.tobytes() and again.dtype == array.dtype


@pytest.mark.parametrize(
    "said", [{"dtype": "O", "shape": [1], "data": ""}, {"dtype": "<f8", "shape": [3], "data": "AAAA"}, {"shape": 3}]
)
def test_what_is_no_array_is_refused(said: object):
    with pytest.raises(InputRefused, match="here: not a state that twin saved"):
        decode_json(said, "here")


ODD: list[Any] = [
    None, True, -1, 0, 1.5, 2**63, 2**64, float("nan"), float("inf"), "", "x", "\0", "f8,f8", "O", [], [1], [[]], {},
    {"a": 1}, {"dtype": "<f8", "shape": [3], "data": ""}, {"dictionary": [1]},
]  # fmt: skip


def places_of(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every value in what JSON says."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [*([path] if path else []), *(found for key, one in inner for found in places_of(one, (*path, key)))]


def test_an_odd_value_in_any_place_of_a_state_is_refused():
    simulation = Simulation(system(), 30, 12)
    simulation.advance()
    content = zstandard.decompress(simulation.state().saved(time=1.2, observers={}).to_bytes())
    (length,) = struct.unpack("<Q", content[:8])
    text, rest = content[8 : 8 + length].decode(), content[8 + length :]
    taken = []
    for path in places_of(json.loads(text)):
        for odd in [*ODD, ...]:
            front = json.loads(text)
            owner = front
            for key in path[:-1]:
                owner = owner[key]
            before = owner[path[-1]]
            owner[path[-1]] = odd
            if odd is ...:
                del owner[path[-1]]
            if odd == before and type(odd) is type(before):
                continue
            try:
                Simulation(system(), 30, 5).restore(SavedState.from_bytes(written(front, rest), "here"))
            except (InputRefused, ComponentFailed):
                continue
            taken.append((path, odd))
    # what is said about a state is looked at by those who said it
    assert {path[0] for path, _ in taken} <= {"about"}, taken
    assert [odd for path, odd in taken if path == ("about", "time")] == [...]


@given(st.data())
def test_any_bytes_in_the_place_of_what_a_part_holds_are_refused_or_gone_on_from(data: st.DataObject):
    saved = saved_at(12)
    pieces = [piece._replace(content=data.draw(st.binary(min_size=len(piece.content), max_size=len(piece.content))))
              for piece in saved.pieces]  # fmt: skip
    inside = [one._replace(content=data.draw(st.binary(max_size=40))) for one in saved.inside]
    simulation = Simulation(system(), 30, 5)
    try:
        simulation.restore(SavedState(saved.tick, pieces, inside, {}))
    except (InputRefused, ComponentFailed):
        return
    simulation.advance()


@pytest.mark.parametrize(("tick", "time"), [(12, 3.0), (12, "soon"), (31, None), (32, None), (2**40, None)])
def test_a_state_whose_tick_and_time_contradict_each_other_or_the_run_is_refused(tick: int, time: object):
    saved = saved_at(12)
    about = {} if time is None else {"time": time}
    bad = SavedState(tick, saved.pieces, saved.inside, about)
    simulation = Simulation(system(), 30, 5)
    if tick == 31:
        # the end of the run, after its last row
        simulation.restore(bad)
        return
    with pytest.raises(InputRefused, match=r"the state (is of tick|says)"):
        simulation.restore(bad)
