"""Recordings and summaries as somebody who means harm, or a tool with a mistake, would leave them: drawn by a seed."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from mcap.opcode import Opcode

from tests.kernel.recording.forgery import Record, content_of, joined, records, sealed, with_content, with_metadata

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e308, -1e308, 1e-300, float("inf"), float("nan"), "", "x", "\0", "\x1b[31m", "x" * 5000,
    [], {}, [[]], [{}], {"a": {}}, [1, 2, 3], 10**400, "../../x", -(10**30), [1, [2, [3]]],
)  # fmt: skip
NO_JSON = ("", "[", "null", "3", "[1, 2]", '"x"', "[" * 100_000, "{" * 5000, "NaN", "{}", "\0", '[["a", 1]]',
           '{"a":' * 900 + "1" + "}" * 900)  # fmt: skip
MESSAGE_FRONT = 22


@dataclass
class Attack:
    """Draws forged runs out of the records and the summary of a good one."""

    data: list[Record]
    summary: str
    draw: Random

    def write(self, folder: Path) -> None:
        """Make `folder` that of a run: run.mcap, whose CRCs are right, and summary.json."""
        folder.mkdir()
        sealed(self._forged(), folder / "run.mcap")
        summary = self._text(self.summary) if self.draw.random() < 0.5 else self.summary
        (folder / "summary.json").write_text(summary)

    def _forged(self) -> list[Record]:
        data, kind = list(self.data), self.draw.random()
        if kind < 0.5:
            wanted = self.draw.choice(["experiment", "experiment", "fmu", "versions", "origins"])
            return with_metadata(data, lambda name, entries: self._entries(entries) if name == wanted else entries)
        if kind < 0.9:
            chunks = [place for place, (opcode, _) in enumerate(data) if opcode == Opcode.CHUNK]
            place = self.draw.choice([chunks[0], self.draw.choice(chunks)])
            data[place] = (Opcode.CHUNK, with_content(data[place][1], self._content(content_of(data[place][1]))))
            return data
        place = self.draw.randrange(len(data))
        if self.draw.random() < 0.5:
            del data[place]
        else:
            data[place] = (self.draw.choice([1, 5, 6, 7, 12, 14, 200]), data[place][1])
        return data

    def _entries(self, entries: dict[str, str]) -> dict[str, str] | None:
        kind = self.draw.random()
        if kind < 0.05 or not entries:
            return None
        key = self.draw.choice(list(entries))
        if kind < 0.1:
            return {other: text for other, text in entries.items() if other != key}
        if kind < 0.15:
            return entries | {self.draw.choice(["x", "\0", "\N{LATIN SMALL LETTER E WITH ACUTE}"]): "y"}
        return entries | {key: self._text(entries[key])}

    def _content(self, content: bytes) -> bytes:
        """Of a chunk: bytes flipped, records lost, doubled or cut, declarations and numbers changed."""
        kind, inner = self.draw.random(), records(content)
        place = self.draw.randrange(len(inner))
        if kind < 0.3:
            return self._flipped(content, self.draw.choice([1, 3, 20]))
        if kind < 0.6:
            declared = [k for k, (opcode, _) in enumerate(inner) if opcode in (Opcode.SCHEMA, Opcode.CHANNEL)] or [0]
            place = self.draw.choice(declared)
            inner[place] = (inner[place][0], self._flipped(inner[place][1], self.draw.choice([1, 2, 8])))
        elif kind < 0.7:
            del inner[place]
        elif kind < 0.8:
            inner.insert(place, self.draw.choice(inner))
        elif kind < 0.9:
            return content[: self.draw.randrange(len(content))]
        else:
            for place in self.draw.choices(range(len(inner)), k=50):
                inner[place] = (inner[place][0], self._number(inner[place][1]))
        return joined(inner)

    def _flipped(self, content: bytes, count: int) -> bytes:
        changed = bytearray(content)
        for place in self.draw.choices(range(len(changed)), k=count):
            changed[place] = self.draw.choice([0, 255, 128, self.draw.randrange(256)])
        return bytes(changed)

    def _number(self, message: bytes) -> bytes:
        if len(message) < MESSAGE_FRONT + 9:
            return message
        place = self.draw.randrange(MESSAGE_FRONT, len(message) - 8)
        number = struct.pack("<d", self.draw.choice([float("nan"), float("inf"), 1e308, 0.0, -1e10]))
        return message[:place] + number + message[place + 8 :]

    def _text(self, text: str) -> str:
        if self.draw.random() < 0.75:
            try:
                return json.dumps(self._value(json.loads(text)))
            except ValueError:
                pass
        return self.draw.choice([*NO_JSON, text[: len(text) // 2]])

    def _value(self, value: Any) -> Any:
        if isinstance(value, dict) and value and self.draw.random() < 0.85:
            key, kind = self.draw.choice(list(value)), self.draw.random()
            if kind < 0.1:
                return {other: item for other, item in value.items() if other != key}
            if kind < 0.15:
                return value | {self.draw.choice(["x", "a\nb", "fmu", "value", "source"]): self.draw.choice(ODD)}
            return value | {key: self._value(value[key])}
        if isinstance(value, list) and value and self.draw.random() < 0.7:
            place = self.draw.randrange(len(value))
            return [*value[:place], self._value(value[place]), *value[place + 1 :]]
        if isinstance(value, int | float) and not isinstance(value, bool) and self.draw.random() < 0.5:
            return self.draw.choice([value * 1e6, -value, value * 0, value * 1e-9, value + 1, value * 10, 1e308])
        return self.draw.choice(ODD)
