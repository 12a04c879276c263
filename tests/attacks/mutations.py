"""Files as chance, carelessness and malice change them; the same seed makes the same file."""

import random
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from twin.kernel.errors import InputRefused

NUMBERS = (b"0", b"-1", b"1e308", b"-1e308", b"1e-308", b"nan", b"inf", b"1e15", b"9" * 500, b"0x" + b"f" * 99, b"1_0")
VALUES = (
    b'""', b"[]", b"{}", b"[[]]", b"[{}]", b"true", b'"a\\u0000b"', b'"' + b"n" * 300 + b'"', b'"~nobody/x"',
    b"{ kind = {} }", b"[[1, 2], [3]]", b"{ value = { value = 1 } }", b"1979-05-27", b"[" * 900, b'"[bold]"',
)  # fmt: skip
BYTES = (b"\0", b"\xff", b"\xef\xbb\xbf", b"\x1b[31m", b"=", b"[", b"]", b'"', b"'", b"\n", b",", b"#", b"a.b.")
LONGEST = 10.0
"""Processor seconds for a file of some kilobytes on a slow machine that others use, too; nearly all take 0.1."""
PARTS: tuple[Any, ...] = (
    None, [], {}, "", "x\x1b[31m[bold]", 0, -1, 1e308, -1e308, 10**30, 10**400, 1.5, True, [[[]]], {"a": {"b": 1}},
)  # fmt: skip
"""What may stand in place of any part of a JSON file."""


def mutated(content: bytes, seed: int) -> bytes:
    """`content` with one to three changes."""
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 3)):
        content = rng.choice(CHANGES)(content, rng)
    return content


def _cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _without(content: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(content) + 1)
    return content[:start] + content[start + rng.choice((1, 2, 10, 100)) :]


def _twice(content: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(content) + 1)
    end = start + rng.choice((1, 10, 100, 1000))
    return content[:end] + content[start:end] + content[end:]


def _with_bytes(content: bytes, rng: random.Random) -> bytes:
    place = rng.randrange(len(content) + 1)
    return content[:place] + rng.choice(BYTES) + content[place:]


def _with_number(content: bytes, rng: random.Random) -> bytes:
    return _replaced(content, rb"(?<![\w.])-?[0-9][0-9.]*", rng.choice(NUMBERS), rng)


def _with_value(content: bytes, rng: random.Random) -> bytes:
    return _replaced(content, rb"(?<== )[^\n#]+", rng.choice(VALUES), rng)


def _lines_exchanged(content: bytes, rng: random.Random) -> bytes:
    lines = content.split(b"\n")
    a, b = (rng.randrange(len(lines)) for _ in range(2))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _replaced(content: bytes, pattern: bytes, by: bytes, rng: random.Random) -> bytes:
    found = list(re.finditer(pattern, content))
    if not found:
        return content
    start, end = rng.choice(found).span()
    return content[:start] + by + content[end:]


CHANGES = (_cut, _without, _twice, _with_bytes, _with_number, _with_number, _with_value, _with_value, _lines_exchanged)


def mutated_json(found: Any, seed: int) -> Any:
    """`found` with one part taken out or exchanged."""
    rng = random.Random(seed)
    path = rng.choice(list(_paths(found)))
    return _exchanged(found, path, rng)


def _paths(found: Any) -> Iterator[tuple[Any, ...]]:
    yield ()
    for key in found if isinstance(found, dict) else range(len(found)) if isinstance(found, list) else ():
        yield from ((key, *rest) for rest in _paths(found[key]))


def _exchanged(found: Any, path: tuple[Any, ...], rng: random.Random) -> Any:
    if not path:
        return rng.choice(PARTS)
    key, *rest = path
    if isinstance(found, list):
        return [_exchanged(part, tuple(rest), rng) if i == key else part for i, part in enumerate(found)]
    if not rest and rng.random() < 0.3:
        return {name: part for name, part in found.items() if name != key}
    return {name: _exchanged(part, tuple(rest), rng) if name == key else part for name, part in found.items()}


def endure(attack: Callable[[int], object], seeds: range) -> int:
    """Carry out `attack` for each of `seeds`; how many of them were refused.

    Anything but success and a refusal in words is a failure, and so is a long time.
    """
    refused = 0
    for seed in seeds:
        began = time.process_time()
        try:
            attack(seed)
        except InputRefused as refusal:
            refused += 1
            assert str(refusal).strip(), f"seed {seed}: refused without a word"
        except Exception as problem:
            pytest.fail(f"seed {seed}: {type(problem).__name__}: {problem}")
        assert time.process_time() - began < LONGEST, f"seed {seed} took too long"
    return refused
