"""The state of a running system: taken and restored in memory, or written down for another process.

A state belongs to the beginning of a tick: components have made all steps before it, the row of the tick is not yet
there. It holds what steps change (memory of components, outputs, what FMUs and Python objects hold) and nothing that
an experiment says, so a system whose constants differ can go on from it. Addresses are no part of it.
"""

import base64
import json
import math
import struct
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard

from twin.kernel.compiled.function import carray, copy
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import Component, Holder, piece_table, pieces_at, runs_of
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused
from twin.kernel.files import json_of

MEDIA_TYPE = "application/x-twin-state"
VERSION = 1
"""Of what `SavedState.to_bytes` writes."""
LARGEST = 64 * 2**20
"""Bytes of a state, unpacked: those of the shipped experiments have some kilobytes."""


@entry("nothing", "int", "int", "int", "int")
def _copy(table, count, buffer, back):
    """Copy pieces of memory to their places in `buffer`, or `back` from there; `PIECE.copy` is the place."""
    pieces = carray(pieces_at(table), count)
    for i in range(count):
        if back:
            copy(pieces[i].array, buffer + pieces[i].copy, pieces[i].size)
        else:
            copy(buffer + pieces[i].copy, pieces[i].array, pieces[i].size)


@dataclass(frozen=True)
class SavedState:
    """A state without addresses, for any process that has made the same system.

    Attributes:
        tick: at whose beginning it was taken.
        pieces: component, name, dtype and shape of each piece of memory.
        memory: their bytes, one piece after the other.
        inside: component, name and bytes of what FMUs, Python objects and other processes hold.
        about: what else belongs to it, of whom it is; what JSON can say.
    """

    tick: int
    pieces: list[list[Any]]
    memory: bytes
    inside: list[tuple[str, str, bytes]]
    about: dict[str, Any]

    def to_bytes(self) -> bytes:
        """Itself, compressed."""
        inside = [[component, name, len(content)] for component, name, content in self.inside]
        front = {"version": VERSION, "tick": self.tick, "pieces": self.pieces, "inside": inside, "about": self.about}
        text = json.dumps(front, separators=(",", ":")).encode()
        contents = [content for *_, content in self.inside]
        return zstandard.compress(b"".join((struct.pack("<Q", len(text)), text, self.memory, *contents)), 3)

    @classmethod
    def from_bytes(cls, content: bytes, where: str) -> "SavedState":
        """What `to_bytes` wrote.

        Args:
            content: the bytes.
            where: what a refusal begins with.

        Raises:
            InputRefused: something else, of another version, or damaged.
        """
        try:
            size = zstandard.frame_content_size(content)
            if not 8 <= size <= LARGEST:
                raise InputRefused(f"{where}: a state of {size} bytes; expected 8 to {LARGEST}")
            whole = zstandard.decompress(content, max_output_size=size)
        except zstandard.ZstdError:
            raise InputRefused(f"{where}: this is no state that twin saved: it does not decompress") from None
        (length,) = struct.unpack("<Q", whole[:8])
        front = json_of(whole[8 : 8 + length], f"{where}: the state's description")
        try:
            if front["version"] != VERSION:
                raise InputRefused(f"{where}: a state of version {front['version']!r}; this twin reads {VERSION}")
            tick, pieces, about = front["tick"], [list(piece) for piece in front["pieces"]], dict(front["about"])
            sizes = [(str(component), str(name), int(size)) for component, name, size in front["inside"]]
        except (KeyError, TypeError, ValueError):
            raise InputRefused(f"{where}: this is no state that twin saved") from None
        if not isinstance(tick, int) or not 0 <= tick < 1 << 62 or any(size < 0 for *_, size in sizes):
            raise InputRefused(f"{where}: this is no state that twin saved: tick {tick!r}")
        end = len(whole) - sum(size for *_, size in sizes)
        if end < 8 + length:
            raise InputRefused(f"{where}: the state is shorter than it says")
        memory, inside = whole[8 + length : end], []
        for component, name, size in sizes:
            inside.append((component, name, whole[end : end + size]))
            end += size
        return cls(tick, pieces, memory, inside, about)


class State:
    """A state in the memory of the process that it was taken in; FMUs hold their part of it.

    Attributes:
        tick: at whose beginning it was taken.
    """

    def __init__(self, places: "StatePlaces", tick: int, memory: np.ndarray, tokens: Sequence[Any]):
        self.tick, self.memory, self.tokens = tick, memory, tuple(tokens)
        self.places = places
        self._freed = weakref.finalize(self, places.free, self.tokens)
        # at the end of the process FMUs are gone first
        self._freed.atexit = False

    def saved(self, **about: Any) -> SavedState:
        """The same for another process, with what else is said `about` it.

        Raises:
            InputRefused: a component's state cannot be written down.
            ComponentFailed: an FMU refuses.
        """
        return self.places.saved(self, about)

    def close(self) -> None:
        """Free what FMUs hold of it; safe to call twice. It happens by itself when nothing refers to the state."""
        self._freed()


class StatePlaces:
    """Where the state of a system lies.

    Args:
        components: of the system.
        outputs: memory of all their outputs, one or several times; none: it is of another system.
        inputs: memory of all their inputs; likewise.

    Raises:
        InputRefused: a component has no state.
    """

    def __init__(self, components: Sequence[Component], outputs: np.ndarray, inputs: np.ndarray):
        refuse_stateless(components, portable=False)
        self._components = components
        self._pieces: list[tuple[str, str, np.ndarray]] = []
        self._holders: list[tuple[str, str, Holder]] = []
        sides = [(name, side, memory) for name, side, memory in (("outputs", 1, outputs), ("inputs", 0, inputs))]
        for name, side, memory in sides if outputs.size else ():
            ends = np.cumsum([0, *(width(c.outputs if side else c.inputs) for c in components)])
            copies = memory.reshape(-1, ends[-1]) if ends[-1] else memory.reshape(1, 0)
            self._pieces += [
                (c.name, name, copies[:, a:b]) for c, a, b in zip(components, ends, ends[1:], strict=False) if b > a
            ]
        for component in components:
            self._pieces += [(component.name, name, array) for name, array in component.pieces().items()]
            self._holders += [(component.name, name, holder) for name, holder in component.holders().items()]
        arrays = [array for *_, array in self._pieces]
        self._table = piece_table(arrays, 0)
        self._size = sum(size for array in arrays for _, size in runs_of(array))

    def take(self, tick: int) -> State:
        """The present state, at the beginning of `tick`.

        Raises:
            ComponentFailed: an FMU refuses.
        """
        memory = np.empty(self._size, dtype=np.uint8)
        _copy(self._table.ctypes.data, len(self._table), memory.ctypes.data, 0)
        return State(self, tick, memory, [holder.take() for *_, holder in self._holders])

    def put_back(self, state: State) -> None:
        """Make `state`, taken here, the present one.

        Raises:
            ComponentFailed: an FMU refuses.
        """
        for (*_, holder), token in zip(self._holders, state.tokens, strict=True):
            holder.give_back(token)
        _copy(self._table.ctypes.data, len(self._table), state.memory.ctypes.data, 1)

    def free(self, tokens: Sequence[Any]) -> None:
        """Let holders forget `tokens`."""
        for (*_, holder), token in zip(self._holders, tokens, strict=False):
            holder.free(token)

    def saved(self, state: State, about: dict[str, Any]) -> SavedState:
        """`state`, taken here, for another process; raises as `State.saved`."""
        refuse_stateless(self._components)
        inside = [
            (component, name, holder.pack(token))
            for (component, name, holder), token in zip(self._holders, state.tokens, strict=True)
        ]
        return SavedState(state.tick, self._described(), state.memory.tobytes(), inside, about)

    def taken(self, saved: SavedState) -> State:
        """A state of this system made of a `saved` one.

        Raises:
            InputRefused: that is of another system, or holds what no component can go on from.
            ComponentFailed: an FMU refuses its part.
        """
        refuse_other_system(saved, self._described(), [(c, n) for c, n, _ in self._holders])
        if len(saved.memory) != self._size:
            raise InputRefused(f"the state has {len(saved.memory)} bytes of memory; this system has {self._size}")
        memory = np.frombuffer(saved.memory, dtype=np.uint8).copy()
        tokens: list[Any] = []
        try:
            for (*_, holder), (*_, content) in zip(self._holders, saved.inside, strict=True):
                tokens.append(holder.unpack(content))
        except BaseException:
            self.free(tokens)
            raise
        return State(self, saved.tick, memory, tokens)

    def adopt(self, saved: SavedState) -> list[str]:
        """Take over what `saved`, of a system with perhaps other components, has of those that are here.

        Returns:
            Names of the components that it has nothing of: they are as they were made.

        Raises:
            InputRefused: a component of the same name has another state.
            ComponentFailed: an FMU refuses its part.
        """
        there, place = {}, 0
        for component, name, kind, shape in saved.pieces:
            dtype, count = np.dtype(kind), math.prod(shape)
            there[component, name] = saved.memory[place : place + dtype.itemsize * count], kind, shape
            place += dtype.itemsize * count
        inside = {(component, name): content for component, name, content in saved.inside}
        known = {component for component, _ in [*there, *inside]}
        for component, name, array in self._pieces:
            if component not in known:
                continue
            content, kind, shape = there.get((component, name), (b"", "", []))
            if (kind, shape) != (array.dtype.str, list(array.shape)):
                raise InputRefused(f"{component}: its {name} is not what the state has; it cannot be another one now")
            array[...] = np.frombuffer(content, dtype=array.dtype).reshape(array.shape)
        for component, name, holder in self._holders:
            if component in known and (component, name) not in inside:
                raise InputRefused(f"{component}: the state does not have its {name}; it cannot be another one now")
            if component in known:
                token = holder.unpack(inside[component, name])
                holder.give_back(token)
                holder.free(token)
        return [component.name for component in self._components if component.name not in known]

    def _described(self) -> list[list[Any]]:
        return [[component, name, array.dtype.str, list(array.shape)] for component, name, array in self._pieces]


def refuse_stateless(components: Iterable[Component], portable: bool = True) -> None:
    """Refuse components without a state that can be saved.

    Raises:
        InputRefused: it names each, and why.
    """
    if missing := stateless(components, portable):
        raise InputRefused("; ".join(missing))


def stateless(components: Iterable[Component], portable: bool = True) -> list[str]:
    """A sentence, without a full stop, on each of `components` whose state cannot be saved."""
    why = [(component, component.lacks_state(portable)) for component in components]
    return [f"{c.label} ({c.name}) {reason}" if c.label else f"{c.name} {reason}" for c, reason in why if reason]


def refuse_other_system(saved: SavedState, pieces: list[list[Any]], holders: list[tuple[str, str]]) -> None:
    """Refuse a state of another system.

    Raises:
        InputRefused: it names the first thing that differs.
    """
    for there, here in zip([*saved.pieces, None], [*pieces, None], strict=False):
        if there != here:
            raise InputRefused(f"the state is of another system: it has {_piece(there)} where this has {_piece(here)}")
    if (inside := [(component, name) for component, name, _ in saved.inside]) != holders:
        raise InputRefused(f"the state is of another system: it holds {inside}, this one {holders}")


def _piece(described: list[Any] | None) -> str:
    if described is None:
        return "nothing more"
    component, name, kind, shape = (*described, "", "", "", "")[:4]
    return f"{f'{component}.' * bool(component)}{name} ({kind} {shape})"


def plain(value: Any) -> Any:
    """`value` (numbers, texts, arrays, tuples, lists and dictionaries of them) as JSON says it."""
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value)).decode()
        return {"dtype": value.dtype.str, "shape": list(value.shape), "data": data}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dictionary": [[plain(key), plain(content)] for key, content in value.items()]}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return value


SIMPLE = "?bhilqBHILQfd"
"""Kinds of numbers that an array read from a file may hold."""


def of_plain(said: Any, where: str) -> Any:
    """What `plain` made `said` of; tuples are lists.

    Args:
        said: what JSON says.
        where: what a refusal begins with.

    Raises:
        InputRefused: nothing that `plain` makes.
    """
    if isinstance(said, list):
        return [of_plain(one, where) for one in said]
    if not isinstance(said, dict):
        return said
    try:
        if "dictionary" in said:
            return {of_plain(key, where): of_plain(content, where) for key, content in said["dictionary"]}
        kind = np.dtype(said["dtype"])
        if kind.char not in SIMPLE:
            raise ValueError(kind)
        data = np.frombuffer(base64.b64decode(said["data"], validate=True), dtype=kind)
        return data.reshape([int(n) for n in said["shape"]]).copy()
    except (KeyError, TypeError, ValueError) as problem:
        raise InputRefused(f"{where}: not a state that twin saved: {problem}") from None
