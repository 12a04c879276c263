"""Files of compiled code with a seal: what was damaged since is thrown away and compiled again.

Numba unpickles and runs whatever its files hold; a truncated one is a traceback at every start. So the hash of what
was written stands at the end of each file, where numba does not look, and is compared before numba reads the file.
That finds accidents. Against malice stands that nobody else can write to the folder, see `twin.cache_folder`.
"""

import contextlib
import hashlib
import io
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

CACHING = "numba.core.caching"
KINDS = (".nbi", ".nbc", ".o", ".ll")
SIZE = 16
"""Bytes of a seal."""

_told: set[str] = set()


def use_seals(folder: Path) -> None:
    """Let numba seal the files that it writes below `folder`, and read only those that are as they were written."""
    if CACHING in sys.modules:
        _change(sys.modules[CACHING], folder)
    else:
        # numba takes longer to import than most commands take
        sys.meta_path.insert(0, _Waiting(folder))  # type: ignore[arg-type]


def damaged_files(folder: Path) -> list[Path]:
    """The files of compiled code below `folder` that are not as they were written."""
    found = ((place, name) for place, folders, files in os.walk(folder) for name in (*folders, *files))
    paths = sorted(Path(place, name) for place, name in found if name.endswith(KINDS))
    return [path for path in paths if not _is_whole(path)]


def sealed(content: bytes) -> bytes:
    """`content` with its seal."""
    return content + _seal(content)


def unsealed(file: Path, folder: Path) -> bytes:
    """What was sealed in a file of `folder`; nothing if there is none, and none is left that was damaged."""
    if not _is_fit(str(file), str(folder) + os.sep):
        return b""
    try:
        return file.read_bytes()[:-SIZE]
    except FileNotFoundError:
        return b""


class _Waiting:
    """Finds numba's cache in place of the usual finder, and changes it as soon as it is loaded.

    No subclass of `importlib.abc`, which every command would have to import.
    """

    def __init__(self, folder: Path):
        self._folder = folder

    def find_spec(self, fullname: str, path: Any, target: ModuleType | None = None) -> "ModuleSpec | None":
        if fullname != CACHING:
            return None
        import importlib.util

        sys.meta_path.remove(self)  # type: ignore[arg-type]
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_change(module: ModuleType) -> None:
                execute(module)
                _change(module, self._folder)

            spec.loader.exec_module = execute_and_change  # type: ignore[method-assign]
        return spec


def _change(caching: Any, folder: Path) -> None:
    """Put seals on what the module numba.core.caching reads and writes below `folder`."""
    plain = caching.IndexDataCacheFile
    inside = str(folder) + os.sep

    class SealedFile(plain):  # type: ignore[misc, valid-type]
        def load(self, key: Any) -> Any:
            kept = super().load(key)
            if kept is None or not self._index_path.startswith(inside):
                return kept
            # processes that compile side by side may have given their files the same number
            compiled_for, data = kept
            return data if compiled_for == key else None

        def _load_index(self) -> Any:
            return super()._load_index() if _is_fit(self._index_path, inside) else {}

        def _load_data(self, name: str) -> Any:
            path = self._data_path(name)
            if not _is_fit(path, inside):
                # numba compiles again what it does not find
                raise FileNotFoundError(path)
            return super()._load_data(name)

        def save(self, key: Any, data: Any) -> None:
            # a full disk, a folder that is gone: the code runs all the same
            with contextlib.suppress(OSError):
                super().save(key, (key, data) if self._index_path.startswith(inside) else data)

        @contextlib.contextmanager
        def _open_for_write(self, filepath: str) -> Iterator[Any]:
            # a folder in its place would stay there for ever
            _is_fit(filepath, inside)
            with super()._open_for_write(filepath) as file:
                if not filepath.startswith(inside):
                    yield file
                    return
                content = io.BytesIO()
                yield content
                file.write(sealed(content.getvalue()))

    caching.IndexDataCacheFile = SealedFile


def _is_fit(path: str, inside: str) -> bool:
    """Whether numba may read `path`; what is damaged is thrown away."""
    if not path.startswith(inside) or _is_whole(Path(path)):
        return True
    try:
        if os.path.isdir(path) and not os.path.islink(path):
            shutil.rmtree(path)
        else:
            os.unlink(path)
    except FileNotFoundError:
        # another process was first, and says so
        return False
    except OSError:
        pass
    if inside not in _told:
        _told.add(inside)
        print(f"twin: compiled code in {inside} was damaged: compiled again", file=sys.stderr)
    return False


def _is_whole(file: Path) -> bool:
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        # nothing to be damaged
        return True
    except OSError:
        return False
    return content[-SIZE:] == _seal(memoryview(content)[:-SIZE])


def _seal(content: bytes | memoryview) -> bytes:
    return hashlib.blake2b(content, digest_size=SIZE).digest()
