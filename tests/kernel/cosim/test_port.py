from enum import IntEnum
from typing import NamedTuple

import numpy as np

from twin.kernel.cosim.port import memory_of, record, record_of


class Law(IntEnum):
    LINEAR = 3


class Settings(NamedTuple):
    law: Law = Law.LINEAR
    gain: float = 0.25
    place: tuple[float, float, float] = (1.0, 2.0, 3.0)
    on: bool = True


def test_a_named_tuple_comes_back_from_its_record_as_it_was():
    kept = np.array([tuple(Settings())], dtype=record_of(Settings))[0]
    assert Settings(Law(kept["law"]), float(kept["gain"]), tuple(kept["place"]), bool(kept["on"])) == Settings()


def test_codes_and_truth_values_are_whole_numbers_and_what_is_added_comes_last():
    kind = record_of(Settings, passes="u8")
    assert kind.names == ("law", "gain", "place", "on", "passes")
    assert [kind[name].base for name in kind.names] == [np.int64, np.float64, np.float64, np.int64, np.uint64]


def test_every_field_lies_where_a_compiler_would_put_it():
    inner = record(count="i8", share="f4")
    outer = record(flag="u1", place="3f8", inners=(inner, (2,)))
    assert inner.itemsize == 16 and outer.fields is not None
    assert {name: (field[0].shape, field[1]) for name, field in outer.fields.items()} == {
        "flag": ((), 0), "place": ((3,), 8), "inners": ((2,), 32),
    }  # fmt: skip


def test_memory_holds_what_is_said_and_zero_besides():
    reader = record(gain="f8", zero="f8")
    memory = memory_of(record(readers=(reader, (2,)), seed="u8", place="3f8"), readers=[(2.0, 1.0)] * 2, seed=2**64 - 1)
    assert memory["readers"]["gain"].tolist() == [[2.0, 2.0]]
    assert memory["seed"].tolist() == [2**64 - 1]
    assert memory["place"].tolist() == [[0.0, 0.0, 0.0]]
