import numpy as np
import pytest

from twin.kernel.compiled import native
from twin.kernel.cosim.component import Component, MemoryPlace, step_function


def test_a_step_is_compiled_once_and_only_when_its_address_is_asked_for(monkeypatch: pytest.MonkeyPatch):
    compiled = []

    def counted(self: native.Native) -> int:
        compiled.append(self.takes)
        return 17

    monkeypatch.setattr(native.Native, "name", "")
    monkeypatch.setattr(native.Native, "_compile_with_numba", counted)
    step = step_function(np.dtype([("x", "f8")]))(lambda m, t, h, u, y: 0)
    assert not compiled
    assert (step.address, step.address) == (17, 17)
    assert len(compiled) == 1


MEMORY = np.dtype([("law", [("gain", "f8"), ("axes", "f8", 3)]), ("count", "i8")], align=True)


def component(memory: object) -> Component:
    made = Component("robot", (), (), True, 0, 0, np.zeros(0))
    made.memory = memory  # type: ignore[attr-defined]
    return made


def test_what_is_written_at_a_place_is_in_the_memory_itself():
    memory = np.zeros(1, dtype=MEMORY)
    place = MemoryPlace("robot", "law", "axes").memory_of(component(memory))
    assert place is not None and place.shape == (1, 3)
    place[...] = 2.0
    assert memory["law"]["axes"][0].tolist() == [2.0, 2.0, 2.0]


@pytest.mark.parametrize(
    ("memory", "record", "field"),
    [
        (np.zeros(1, dtype=MEMORY), "law", "gains"),
        (np.zeros(1, dtype=MEMORY), "count", "gain"),
        (np.zeros(3), "law", "gain"),
        (None, "law", "gain"),
    ],
    ids=["another field", "no record", "plain numbers", "nothing"],
)
def test_a_component_that_keeps_nothing_there_has_no_such_place(memory: object, record: str, field: str):
    assert MemoryPlace("robot", record, field).memory_of(component(memory)) is None


def test_a_component_without_memory_has_no_places():
    assert MemoryPlace("robot", "law", "gain").memory_of(Component("robot", (), (), True, 0, 0, np.zeros(0))) is None
