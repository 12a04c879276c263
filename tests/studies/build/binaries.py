"""Shared libraries of Linux, Windows and macOS, as far as a test asks: for which processor, what they give and need."""

import struct
from collections.abc import Iterator
from typing import Any, NamedTuple


class Binary(NamedTuple):
    """A shared library.

    Attributes:
        kind: "ELF", "PE" or "Mach-O".
        processor: "x86_64" or "aarch64".
        exports: functions that it gives.
        imports: symbols that it needs; of macOS without the underscore in front.
        libraries: what it needs them from.
        signed: whether it carries a signature of macOS.
    """

    kind: str
    processor: str
    exports: set[str]
    imports: set[str]
    libraries: set[str]
    signed: bool = False


def slices(content: bytes) -> list[bytes]:
    """The libraries within one of macOS for several processors; of any other, it."""
    if content[:4] != b"\xca\xfe\xba\xbe":
        return [content]
    (count,) = struct.unpack_from(">I", content, 4)
    places = [struct.unpack_from(">IIIII", content, 8 + 20 * n) for n in range(count)]
    assert all(start % (1 << alignment) == 0 for _, _, start, _, alignment in places)
    return [content[start : start + size] for _, _, start, size, _ in places]


def binary(content: bytes) -> Binary:
    """What a library for one processor is.

    Raises:
        ValueError: it is none.
    """
    if content[:4] == b"\x7fELF":
        return _elf(content)
    if content[:2] == b"MZ":
        return _pe(content)
    if content[:4] == b"\xcf\xfa\xed\xfe":
        return _macho(content)
    raise ValueError(f"no library begins with {content[:4]!r}")


def _text(content: bytes, at: int) -> str:
    return content[at : content.index(0, at)].decode()


def _elf(content: bytes) -> Binary:
    def at(form: str, place: int) -> Any:
        return struct.unpack_from(form, content, place)

    (machine,), (start,), (size, count) = at("<H", 18), at("<Q", 40), at("<HH", 58)
    sections = [at("<IIQQQQIIQQ", start + n * size) for n in range(count)]
    found: tuple[set[str], set[str], set[str]] = (set(), set(), set())
    exports, imports, libraries = found
    for _, kind, _, _, place, length, link, *_ in sections:
        strings = sections[link][4] if link < count else 0
        if kind == 11:
            for symbol in range(place + 24, place + length, 24):
                name, info, _, section = at("<IBBH", symbol)
                if section and info & 15 == 2:
                    exports.add(_text(content, strings + name))
                elif not section and info >> 4 == 1:
                    imports.add(_text(content, strings + name))
        if kind == 6:
            entries = [at("<QQ", entry) for entry in range(place, place + length, 16)]
            libraries |= {_text(content, strings + value) for tag, value in entries if tag == 1}
    return Binary("ELF", {62: "x86_64", 183: "aarch64"}[machine], exports, imports, libraries)


def _pe(content: bytes) -> Binary:
    def at(form: str, place: int) -> Any:
        return struct.unpack_from(form, content, place)

    (head,) = at("<I", 0x3C)
    assert content[head : head + 4] == b"PE\0\0"
    machine, count = at("<HH", head + 4)
    (optional,) = at("<H", head + 20)
    sections = [at("<IIII", head + 24 + optional + 40 * n + 8) for n in range(count)]

    def place(address: int) -> int:
        """Where in the file what is loaded to `address` lies."""
        return next(
            raw + address - start
            for size, start, length, raw in sections
            if start <= address < start + max(size, length)
        )

    def thunks(first: int) -> Iterator[int]:
        entry = place(first)
        while at("<Q", entry)[0]:
            yield at("<Q", entry)[0]
            entry += 8

    exported, _, imported = at("<III", head + 24 + 112)
    names, table = at("<I", place(exported) + 24)[0], at("<I", place(exported) + 32)[0]
    exports = {_text(content, place(at("<I", place(table) + 4 * n)[0])) for n in range(names)}
    imports: set[str] = set()
    libraries: set[str] = set()
    entry = place(imported)
    while at("<I", entry + 12)[0]:
        libraries.add(_text(content, place(at("<I", entry + 12)[0])))
        imports |= {_text(content, place(thunk) + 2) for thunk in thunks(at("<I", entry)[0])}
        entry += 20
    return Binary("PE", {0x8664: "x86_64"}[machine], exports, imports, libraries)


def _macho(content: bytes) -> Binary:
    def at(form: str, place: int) -> Any:
        return struct.unpack_from(form, content, place)

    (processor,), (commands,) = at("<I", 4), at("<I", 16)
    found: tuple[set[str], set[str], set[str]] = (set(), set(), set())
    exports, imports, libraries = found
    command, signed = 32, False
    for _ in range(commands):
        kind, size = at("<II", command)
        signed |= kind == 0x1D
        if kind == 0xC:
            libraries.add(_text(content, command + at("<I", command + 8)[0]))
        if kind == 2:
            symbols, count, strings, _ = at("<IIII", command + 8)
            for n in range(count):
                string, told, *_ = at("<IBBHQ", symbols + 16 * n)
                text = _text(content, strings + string).removeprefix("_")
                if told & 1:
                    (exports if told & 0xE else imports).add(text)
        command += size
    name = {0x01000007: "x86_64", 0x0100000C: "aarch64"}[processor]
    return Binary("Mach-O", name, exports, imports, libraries, signed)
