"""State of a running system: saved and restored in memory, or serialised for another process.

A state belongs to the beginning of a tick: all steps before it are complete, and the row of the tick is not yet
written. It contains values that steps change (component memory, outputs, the state of FMUs and Python objects) but no
constants of the experiment, so a system with other constants can continue from it. It contains no addresses.
"""

import base64
import json
import math
import re
import struct
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
import zstandard

from twin.kernel.cosim.component import Component, Holder, Pieces
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json

MEDIA_TYPE = "application/x-twin-state"
VERSION = 1
"""Format version of `SavedState.to_bytes`."""
PORT_SIDES = ("outputs", "inputs")
"""Names of the pieces in the master's memory."""
MAX_STATE_SIZE = 64 * 2**20
"""Maximum uncompressed size of a state (bytes); states of the shipped experiments have some kilobytes."""
_DTYPE_PATTERN = re.compile(r"[<>|](?:b1|[iu][1248]|f[248]|V\d{1,6})")
"""Valid dtypes of a piece: numbers, or a record."""
SIMPLE_DTYPES = "?bhilqBHILQfd"
"""Type codes that an array read from a file may have."""


class SavedPiece(NamedTuple):
    """A saved piece of a component's memory: component, piece name, dtype and shape of its numbers, and content."""

    component: str
    name: str
    kind: str
    shape: list[int]
    content: bytes

    @property
    def form(self) -> tuple[str, str, str, list[int]]:
        """Form of a saved memory piece, without its content: component, name, dtype, shape."""
        return self[:4]

    def __str__(self) -> str:
        return f"{self.component}.{self.name} ({self.kind} {self.shape})"


class SavedContent(NamedTuple):
    """Saved state of a component from an FMU, a Python object or another process: component, holder name, content."""

    component: str
    name: str
    content: bytes


@dataclass(frozen=True)
class SavedState:
    """State of a system without addresses, which any process with the same system can restore.

    `inside` are states in FMUs, Python objects or processes. `about` is other JSON data, such as the run's identity.
    """

    tick: int
    pieces: list[SavedPiece]
    inside: list[SavedContent]
    about: dict[str, Any]

    def to_bytes(self) -> bytes:
        """Serialise and compress the saved state of a system."""
        pieces = [[*piece.form, len(piece.content)] for piece in self.pieces]
        inside = [[one.component, one.name, len(one.content)] for one in self.inside]
        front = {"version": VERSION, "tick": self.tick, "pieces": pieces, "inside": inside, "about": self.about}
        text = json.dumps(front, separators=(",", ":")).encode()
        contents = [*(piece.content for piece in self.pieces), *(one.content for one in self.inside)]
        return zstandard.compress(b"".join((struct.pack("<Q", len(text)), text, *contents)), 3)

    @classmethod
    def from_bytes(cls, content: bytes, where: str) -> "SavedState":
        """Read a state written by `to_bytes`; InputRefused if it is invalid, of another version, or damaged."""
        try:
            size = zstandard.frame_content_size(content)
            if not 8 <= size <= MAX_STATE_SIZE:
                raise InputRefused(f"{where}: a state of {size} bytes; expected 8 to {MAX_STATE_SIZE}")
            whole = zstandard.decompress(content, max_output_size=size)
        except zstandard.ZstdError:
            raise InputRefused(f"{where}: this is not a state that twin saved: it does not decompress") from None
        (length,) = struct.unpack("<Q", whole[:8])
        front = parse_json(whole[8 : 8 + length], f"{where}: the state's description")
        other = InputRefused(f"{where}: this is not a state that twin saved")
        kinds = {"version": int, "pieces": list, "inside": list, "about": dict}
        if not isinstance(front, dict) or not all(type(front.get(name)) is kind for name, kind in kinds.items()):
            raise other
        if front["version"] != VERSION:
            raise InputRefused(f"{where}: a state of version {front['version']!r}; this twin reads {VERSION}")
        tick, about, contents = front.get("tick"), front["about"], BytesIO(whole[8 + length :])
        if type(tick) is not int or not 0 <= tick < 1 << 62:
            raise InputRefused(f"{where}: this is not a state that twin saved: tick {tick!r}")
        if not all(
            _has_types(one, [str, str, str, list, int])
            and all(type(n) is int for n in one[3])
            and _DTYPE_PATTERN.fullmatch(one[2])
            and 0 <= one[4] <= MAX_STATE_SIZE
            for one in front["pieces"]
        ):
            raise other
        if not all(_has_types(one, [str, str, int]) and 0 <= one[2] <= MAX_STATE_SIZE for one in front["inside"]):
            raise other
        pieces = [
            SavedPiece(c, name, kind, shape, contents.read(size)) for c, name, kind, shape, size in front["pieces"]
        ]
        inside = [SavedContent(component, name, contents.read(size)) for component, name, size in front["inside"]]
        for piece in pieces:
            size = math.prod(piece.shape) * np.dtype(piece.kind).itemsize
            if min(piece.shape, default=0) < 0 or len(piece.content) != size:
                raise InputRefused(f"{where}: the state is damaged: {piece} has {len(piece.content)} bytes")
        if contents.read(1) or sum(one[-1] for one in (*front["pieces"], *front["inside"])) != contents.tell():
            raise InputRefused(f"{where}: the state is damaged: its parts do not have the stated lengths")
        return cls(tick, pieces, inside, about)


def _has_types(values: Any, kinds: list[type]) -> bool:
    """Whether a JSON value is a list with items of exactly these types."""
    return isinstance(values, list) and list(map(type, values)) == kinds


class SystemState:
    """Saved state of a system in the memory of its own process; FMUs hold their part of it."""

    def __init__(self, places: "StatePlaces", tick: int, memory: np.ndarray, tokens: Sequence[Any]):
        self.tick, self.memory, self.tokens = tick, memory, tuple(tokens)
        self.places = places
        self._freed = weakref.finalize(self, places.free, self.tokens)
        # FMUs are already freed when the process exits
        self._freed.atexit = False

    def saved(self, **about: Any) -> SavedState:
        """Export the state for another process, with data `about` it.

        InputRefused: a component's state cannot be serialised. ComponentFailed: an FMU refuses.
        """
        return self.places.export_state(self, about)

    def close(self) -> None:
        """Free the parts of the saved state that FMUs store; safe to call twice, and called by garbage collection."""
        self._freed()


def holds_all(holder: Holder) -> bool:
    """Whether a state holder saves its whole component, which lives in another process."""
    return bool(getattr(holder, "whole", False))


class StatePlaces:
    """Memory pieces and holders that together contain the state of a system, to save and restore it.

    `outputs` and `inputs` are the memory of all of them, in one or several copies; empty if of another system.
    """

    def __init__(self, components: Sequence[Component], outputs: np.ndarray, inputs: np.ndarray):
        refuse_stateless(components, portable=False)
        self._components = components
        self._pieces: list[tuple[str, str, np.ndarray]] = []
        self._holders: list[tuple[str, str, Holder]] = []
        for name, memory in zip(PORT_SIDES, (outputs, inputs), strict=True) if outputs.size else ():
            ends = np.cumsum([0, *(width(getattr(c, name)) for c in components)])
            copies = memory.reshape(-1, ends[-1]) if ends[-1] else memory.reshape(1, 0)
            self._pieces += [
                (c.name, name, copies[:, a:b]) for c, a, b in zip(components, ends, ends[1:], strict=False) if b > a
            ]
        for component in [c for c in components if not c.alive]:
            self._pieces += [(component.name, name, array) for name, array in component.pieces().items()]
            self._holders += [(component.name, name, holder) for name, holder in component.holders().items()]
        self._memory = Pieces(array for *_, array in self._pieces)

    def save_state(self, tick: int) -> SystemState:
        """Save the present state of the system, at the beginning of `tick`."""
        return SystemState(self, tick, self._memory.save(), [holder.save_state() for *_, holder in self._holders])

    def restore_state(self, state: SystemState) -> None:
        for (*_, holder), token in zip(self._holders, state.tokens, strict=True):
            holder.restore_state(token)
        self._memory.restore(state.memory)

    def free(self, tokens: Sequence[Any]) -> None:
        for (*_, holder), token in zip(self._holders, tokens, strict=False):
            holder.free(token)

    def export_state(self, state: SystemState, about: dict[str, Any]) -> SavedState:
        """Export a state of the system that was saved here, for another process; errors as in `SystemState.saved`."""
        refuse_stateless(self._components)
        order = {component.name: number for number, component in enumerate(self._components)}
        pieces: list[SavedPiece] = []
        inside: list[SavedContent] = []
        place = 0
        for component, name, array in self._pieces:
            content = state.memory[place : place + array.nbytes].tobytes()
            pieces.append(SavedPiece(component, name, array.dtype.str, list(array.shape), content))
            place += array.nbytes
        for (component, name, holder), token in zip(self._holders, state.tokens, strict=True):
            content = holder.pack(token)
            if holds_all(holder):
                there, before = SavedState.from_bytes(content, component), _member_prefix(name)
                pieces += [piece._replace(component=component, name=before + piece.name) for piece in there.pieces]
                inside += [its._replace(component=component, name=before + its.name) for its in there.inside]
            else:
                inside.append(SavedContent(component, name, content))
        # all ports, then the memory of each component
        pieces.sort(key=lambda piece: -1 if piece.name in PORT_SIDES else order[piece.component])
        return SavedState(state.tick, pieces, inside, about)

    def import_state(self, saved: SavedState) -> SystemState:
        """Convert a state from another process or file, of the same system, to a state that can be restored here."""
        pieces, contents = self._split_state(saved)
        described = [(c, name, array.dtype.str, list(array.shape)) for c, name, array in self._pieces]
        there, held = {piece.form[:2]: piece for piece in pieces}, {holder[:2] for holder in self._holders}
        for form in described:
            if form[:2] not in there or there[form[:2]].form != form:
                its = there.get(form[:2], "nothing of that name")
                raise InputRefused(f"the state is of another system: it has {its} for {SavedPiece(*form, b'')}")
        if len(there) != len(described) or len(pieces) != len(described) or contents.keys() != held:
            named = {form[:2] for form in described}
            more = [".".join(key) for key in [*there, *contents] if key not in named and key not in held]
            raise InputRefused(
                f"the state is of another system: {', '.join(more[:3]) or 'parts of it'} fit nothing here"
            )
        memory = np.frombuffer(b"".join(there[form[:2]].content for form in described), dtype=np.uint8).copy()
        tokens: list[Any] = []
        try:
            for component, name, holder in self._holders:
                tokens.append(holder.unpack(contents[component, name]))
        except BaseException:
            self.free(tokens)
            raise
        return SystemState(self, saved.tick, memory, tokens)

    def adopt(self, saved: SavedState) -> list[str]:
        """Restore the components that `saved`, possibly of another system, has; return the names of the others."""
        pieces, contents = self._split_state(saved)
        there = {piece.form[:2]: piece for piece in pieces}
        known = {component for component, _ in [*there, *contents]}
        for component, name, array in self._pieces:
            if component not in known:
                continue
            piece = there.get((component, name))
            if name == "inputs" and (piece is None or piece.shape != list(array.shape)):
                # inputs are written again before each step
                continue
            if piece is None or piece.form[2:] != (array.dtype.str, list(array.shape)):
                raise InputRefused(f"{component}: its {name} is not what the state has; it cannot be another one now")
            array[...] = np.frombuffer(piece.content, dtype=array.dtype).reshape(array.shape)
        for component, name, holder in self._holders:
            if component in known and (component, name) not in contents:
                raise InputRefused(f"{component}: the state does not have its {name}; it cannot be another one now")
            if component in known:
                token = holder.unpack(contents[component, name])
                holder.restore_state(token)
                holder.free(token)
        return [component.name for component in self._components if component.name not in known]

    def _split_state(self, saved: SavedState) -> tuple[list[SavedPiece], dict[tuple[str, str], bytes]]:
        """Split a saved state into this process's memory pieces, and states by (component, holder name).

        A holder of a whole component that lives in another process gets a `SavedState` with all its pieces.
        """
        pieces, left = list(saved.pieces), list(saved.inside)
        contents: dict[tuple[str, str], bytes] = {}
        for component, name, holder in self._holders:
            if holds_all(holder):
                before = _member_prefix(name)
                its = [
                    p
                    for p in pieces
                    if p.component == component and p.name not in PORT_SIDES and p.name.startswith(before)
                ]
                inside = [one for one in left if one.component == component and one.name.startswith(before)]
                pieces, left = [p for p in pieces if p not in its], [one for one in left if one not in inside]
                own, cut = before[:-1] or component, len(before)
                its = [piece._replace(component=own, name=piece.name[cut:]) for piece in its]
                inside = [one._replace(component=own, name=one.name[cut:]) for one in inside]
                if its or inside:
                    contents[component, name] = SavedState(saved.tick, its, inside, {}).to_bytes()
        return pieces, contents | {one[:2]: one.content for one in left}


def _member_prefix(name: str) -> str:
    """Return the prefix "member." of a nested holder's name; "" for a holder of the component itself."""
    return name[: name.rfind(".") + 1]


def refuse_stateless(components: Iterable[Component], portable: bool = True) -> None:
    """Raise an error if the state of any component cannot be saved, with the reason for each."""
    if missing := stateless_reasons(components, portable):
        raise InputRefused("; ".join(missing))


def stateless_reasons(components: Iterable[Component], portable: bool = True) -> list[str]:
    """Return a sentence without full stop for each component whose state is needed and cannot be saved."""
    why = [(component, component.lacks_state(portable)) for component in components if not component.alive]
    return [f"{c.label} ({c.name}) {reason}" if c.label else f"{c.name} {reason}" for c, reason in why if reason]


def encode_json(value: Any) -> Any:
    """Convert numbers, strings, arrays, and nested tuples, lists and dictionaries of them to JSON-compatible values."""
    if isinstance(value, np.ndarray):
        data = base64.b64encode(value.tobytes()).decode()
        return {"dtype": value.dtype.str, "shape": list(value.shape), "data": data}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dictionary": [[encode_json(key), encode_json(content)] for key, content in value.items()]}
    if isinstance(value, (list, tuple)):
        return [encode_json(one) for one in value]
    return value


def decode_json(stated: Any, where: str) -> Any:
    """Restore a value from the result of `encode_json`; tuples become lists."""
    if isinstance(stated, list):
        return [decode_json(one, where) for one in stated]
    if not isinstance(stated, dict):
        return stated
    try:
        if "dictionary" in stated:
            return {decode_json(key, where): decode_json(content, where) for key, content in stated["dictionary"]}
        kind = np.dtype(stated["dtype"])
        if kind.char not in SIMPLE_DTYPES:
            raise ValueError(kind)
        data = np.frombuffer(base64.b64decode(stated["data"], validate=True), dtype=kind)
        return data.reshape([int(n) for n in stated["shape"]]).copy()
    except (KeyError, TypeError, ValueError, OverflowError) as problem:
        raise InputRefused(f"{where}: not a state that twin saved: {problem}") from None
