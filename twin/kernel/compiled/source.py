"""Digests of source code without comments and docstrings; compiled functions are named after them.

Statements that are only a string, and blank lines, are ignored too, so that editing text recompiles nothing. Parsing
takes 1.5 ms per file; results are stored under the digest of the whole file, so unchanged files are not parsed again.
"""

import ast
import contextlib
import io
import os
import re
import sys
import sysconfig
import tokenize
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from hashlib import blake2b
from importlib.util import decode_source, resolve_name
from pathlib import Path
from typing import NamedTuple

PACKAGE_FOLDER = Path(__file__).parents[2]
INSTALLED_PATTERN = re.compile(re.escape(sysconfig.get_path("stdlib") + os.sep) + r"|.*[/\\](site|dist)-packages[/\\]")
"""Paths of installed files, identified by the version of Python or of their package; excludes this package."""


class SourceFile(NamedTuple):
    """Digest of a Python file without comments and docstrings, imports (module, names), first lines of functions.

    Imports inside functions are included, and modules are as written; lines ascend.
    """

    digest: str
    imports: tuple[tuple[str, tuple[str, ...]], ...]
    functions: tuple[int, ...]


def digest_of(content: bytes) -> str:
    """Compute a short BLAKE2 hash (8 bytes) of a text or bytes, as hex."""
    return blake2b(content, digest_size=8).hexdigest()


def parse_source(content: bytes) -> SourceFile:
    """Parse a Python file into its digest, imports and function positions; invalid Python is hashed as a whole."""
    try:
        text = decode_source(content)
        nodes = list(ast.walk(ast.parse(text)))
        code = _without_text(text, nodes)
    except (SyntaxError, ValueError, tokenize.TokenError):
        return SourceFile(digest_of(content), (), ())
    imports = dict.fromkeys(pair for node in nodes for pair in _imports(node))
    # a function begins at its first decorator, if any
    functions = {
        min([node.lineno, *(decorator.lineno for decorator in getattr(node, "decorator_list", ()))])
        for node in nodes
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    }
    return SourceFile(digest_of(code.encode()), tuple(imports), tuple(sorted(functions)))


def _without_text(text: str, nodes: Sequence[ast.AST]) -> str:
    """Remove comments, string statements (docstrings), trailing blanks and empty lines from Python source."""
    lines = text.split("\n")
    cuts: list[tuple[int, int, int]] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            cuts.append((token.start[0] - 1, token.start[1], token.end[1]))
    for node in nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            first, last = node.lineno - 1, (node.end_lineno or 0) - 1
            for number in range(first, last + 1):
                # ast counts columns in bytes of UTF-8
                line = lines[number].encode()
                start = len(line[: node.col_offset].decode()) if number == first else 0
                end = len(line[: node.end_col_offset].decode()) if number == last else len(lines[number])
                cuts.append((number, start, end))
    for number, start, end in sorted(cuts, reverse=True):
        lines[number] = lines[number][:start] + lines[number][end:]
    return "\n".join(line.rstrip() for line in lines if line.strip())


def _imports(node: ast.AST) -> Iterator[tuple[str, tuple[str, ...]]]:
    if isinstance(node, ast.Import):
        yield from ((alias.name, ()) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield "." * node.level + (node.module or ""), tuple(alias.name for alias in node.names)


class Sources:
    """Parser of source files that are not installed; `known` has the files parsed before, by their digest."""

    def __init__(self, known: dict[str, SourceFile]):
        self.known, self.parsed = known, 0
        self._of: dict[str, SourceFile | None] = {}

    def digest(self, *modules: str) -> str:
        """Compute the digest of the source code of `modules` and of all their direct and indirect imports."""
        reached: dict[str, str] = {}
        ahead = list(modules)
        while ahead:
            module = ahead.pop()
            if module not in reached:
                source = self.source(module)
                reached[module] = source.digest if source else ""
                ahead += self._imported_modules(module, source) if source else ()
        return digest_of("".join(name + digest for name, digest in sorted(reached.items()) if digest).encode())

    def place(self, function: Callable) -> int:
        """Return the index of a function among the functions of its file; edits of earlier text keep it."""
        source = self.source(function.__module__)
        return bisect_left(source.functions, function.__code__.co_firstlineno) if source else 0

    def source(self, module: str) -> SourceFile | None:
        """Return the parsed source file of a module; None if it has no file or is an installed package."""
        if module not in self._of:
            file = source_file(module)
            self._of[module] = self._read_source(Path(file)) if file else None
        return self._of[module]

    def _read_source(self, path: Path) -> SourceFile:
        content = path.read_bytes()
        whole = digest_of(content)
        if whole not in self.known:
            self.known[whole] = parse_source(content)
            self.parsed += 1
        return self.known[whole]

    def _imported_modules(self, module: str, source: SourceFile) -> set[str]:
        """Return the modules that a module may import; a name imported from a package counts as a possible module."""
        file = source_file(module) or ""
        package = module if file.endswith("__init__.py") else module.rpartition(".")[0]
        found: set[str] = set()
        for origin, names in source.imports:
            # a relative import may point outside the package
            with contextlib.suppress(ImportError):
                whole = resolve_name(origin, package)
                found.add(whole)
                if (source_file(whole) or "").endswith("__init__.py"):
                    found |= {f"{whole}.{name}" for name in names}
        return found


@cache
def source_file(module: str) -> str | None:
    """Return the source file of a module of this package, or of a loaded module that is not installed; else None."""
    top, _, below = module.partition(".")
    if top == PACKAGE_FOLDER.name:
        stem = os.path.join(PACKAGE_FOLDER, *below.split("."))
        return next((file for file in (stem + ".py", os.path.join(stem, "__init__.py")) if os.path.isfile(file)), None)
    found: str | None = getattr(sys.modules.get(module), "__file__", None)
    return found if found and os.path.isfile(found) and not INSTALLED_PATTERN.match(found) else None
