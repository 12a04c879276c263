"""Input files: regular, of bounded size, of the expected kind."""

import json
import os
import re
import stat
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from twin.kernel.errors import PATH_ERRORS, InputRefused, close_matches, translate_disk_errors

MAX_TEXT_BYTES = 10 * 2**20
"""Maximum size of a text file (bytes); an experiment has a few kilobytes."""
MAX_TOML_BYTES = 2 * 2**20
"""Maximum size of a TOML file (bytes): its parser takes about 2 s for it, and 50,000 way points need no more."""
FILE_SIGNATURES = (
    (b"\x89PNG", "a PNG picture"),
    (b"\x89MCAP0", "an MCAP recording"),
    (b"PK\x03\x04", "a ZIP archive, as FMUs are"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\xff\xfe", "text in UTF-16"),
    (b"\xfe\xff", "text in UTF-16"),
    (b"%PDF", "a PDF document"),
)
"""First bytes of a file -> its kind."""
BOM = b"\xef\xbb\xbf"
MAX_DEPTH = 32
"""Maximum nesting of tables, arrays or elements, and of parts of a dotted key; twin's own files have five."""
_TOML_TOKEN = re.compile(
    r"""[ \t]+ | \#[^\n]*
    | "{3}(?:\\.|[^\\])*?(?:"{3}|\\?\Z) | '{3}.*?(?:'{3}|\Z)
    | "(?:\\[^\n]|[^"\\\n])*(?:"|\\?(?=\n|\Z)) | '[^'\n]*(?:'|(?=\n|\Z))""",
    re.DOTALL | re.VERBOSE,
)
"""Blanks and comments, which are skipped between parts of a TOML key, and quoted text, which is one part. Unclosed
quotes end with the line or the text, so that each character is scanned once."""


def read_bytes(path: Path, limit: int = MAX_TEXT_BYTES, kind: str = "file") -> bytes:
    """Read the regular file at `path`, at most `limit` bytes; messages call it `kind`: "experiment file".

    InputRefused: no such file, a folder, a pipe or a device, too large, unreadable.
    """
    with open_regular(path, limit, kind) as file, translate_disk_errors(path, "cannot be read", InputRefused):
        return file.read(limit)


def open_regular(path: Path, limit: int, kind: str = "file") -> BinaryIO:
    """Open the regular file at `path` for reading; see `read_bytes`."""
    with translate_disk_errors(path, "cannot be read", InputRefused, caught=PATH_ERRORS):
        try:
            # non-blocking: opening a pipe without a writer would block
            handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        except FileNotFoundError:
            raise InputRefused(f"{path}: no such {kind}{suggestion(path)}") from None
    found = os.fstat(handle)
    what = ""
    if stat.S_ISDIR(found.st_mode):
        what = f"a folder; expected {'an' if kind[0] in 'aeiou' else 'a'} {kind}"
    elif not stat.S_ISREG(found.st_mode):
        what = "not a regular file but a pipe, socket or device; expected a file"
    elif found.st_size > limit:
        what = f"more than {limit / 2**20:g} MB; expected a smaller file"
    if what:
        os.close(handle)
        raise InputRefused(f"{path}: {what}")
    return open(handle, "rb")


def suggestion(path: Path) -> str:
    """Return a hint to the nearest name, `; did you mean 'folder/file.toml'?`; "" without a similar name."""
    try:
        beside = {there.stem: there for there in path.parent.iterdir() if there.suffix == path.suffix}
    except PATH_ERRORS:
        return ""
    return "".join(f"; did you mean '{beside[name]}'?" for name in close_matches(path.stem, list(beside)))


def foreign_kind(content: bytes) -> str:
    """Return the kind of a binary file, recognised by its first bytes, see `FILE_SIGNATURES`; "" for any other file."""
    return next((kind for beginning, kind in FILE_SIGNATURES if content.startswith(beginning)), "")


def read_text(path: Path, limit: int = MAX_TEXT_BYTES, kind: str = "file") -> str:
    """Read the UTF-8 text of the regular file at `path`; arguments as in `read_bytes`."""
    content = read_bytes(path, limit, kind)
    if what := foreign_kind(content):
        raise InputRefused(f"{path}: {what}; expected text in UTF-8")
    if content.startswith(BOM):
        raise InputRefused(f"{path}: begins with a byte order mark; save it as UTF-8 without one ('without BOM')")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputRefused(
            f"{path}: not text in UTF-8: byte {problem.start} is {content[problem.start]:#04x}"
        ) from None


def read_toml(path: Path, kind: str = "file") -> dict[str, Any]:
    """Read the tables of the TOML file at `path`; `kind` as in `read_bytes`."""
    return parse_toml(read_text(path, MAX_TOML_BYTES, kind), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    # the parser's time grows with the square of the number of a key's parts, which may be quoted and separated by
    # blanks
    bare = _TOML_TOKEN.sub(lambda token: "" if token[0].isspace() or token[0].startswith("#") else "_", text)
    if any(part.count(".") > MAX_DEPTH for part in re.split(r"[=,\[\]{}\n]", bare)):
        raise InputRefused(f"{where}: not valid TOML: a key of more than {MAX_DEPTH} parts")
    return _parse("TOML", tomllib.loads, text, where)


def read_json(path: Path) -> Any:
    return parse_json(read_text(path), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    return _parse("JSON", json.loads, text, where)


def parse_xml(content: bytes, where: str) -> ET.Element:
    """Parse `content` as XML and return its root element."""
    parser = ET.XMLParser(target=_SafeTreeBuilder())
    root: ET.Element = _parse("XML", lambda text: ET.XML(text, parser), content, where)
    return root


class _SafeTreeBuilder(ET.TreeBuilder):
    """XML element builder that limits the depth and refuses document types, whose entities can multiply elements."""

    _depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("it has a document type (DOCTYPE); do not trust this file")

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise RecursionError
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def _parse(language: str, parse: Callable[[Any], Any], text: str | bytes, where: str) -> Any:
    try:
        return _check_values(parse(text))
    except RecursionError:
        raise InputRefused(f"{where}: not valid {language}: nested too deeply") from None
    # not only the parser's own error: a number of 5,000 digits is a plain ValueError, an unknown encoding a LookupError
    except (ET.ParseError, ValueError, LookupError) as problem:
        raise InputRefused(f"{where}: not valid {language}: {problem}") from None


def _check_values(found: Any) -> Any:
    """Return a parsed value; RecursionError: more than `MAX_DEPTH` deep, ValueError: an integer of over 64 bits."""
    level = [found]
    for _ in range(MAX_DEPTH):
        if any(isinstance(value, int) and value.bit_length() > 64 for value in level):
            raise ValueError("a whole number of more than 64 bits")
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            return found
    raise RecursionError
