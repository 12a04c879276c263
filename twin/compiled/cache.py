"""Where compiled code is kept between processes.

Numba checks only the file of a cached function itself: after an edit of `robot/jacobian.py` it would go on using the
old machine code inlined into `plant/`. So the folder is named after the content of all source that compiled code may
be made of: every sub-package in which some file has compiled functions, and the files above them. Floors that
compiled code stands on hold compiled code themselves, or nothing that it freezes.
"""

import contextlib
import hashlib
import os
import re
import sys
from functools import cache
from pathlib import Path

from twin.cache_folder import (
    PRIVATE,
    REMEDY,
    cache_base,
    cache_folder,
    discard_foreign,
    evict,
    hold,
    private_folder,
    remove,
)
from twin.compiled.seal import use_seals
from twin.errors import InputRefused, disk_refusals
from twin.places import sources

NAME = "native"
KEPT = 3
COMPILES = re.compile(rb"^(from|import) (numba|twin\.compiled\.(function|native))\b", re.MULTILINE)

_refusal: list[str] = []


def source_digest(package: Path) -> str:
    """Hash over the names and the content of the Python files of `package` that compiled code is made of."""
    texts = sources(str(package))
    # the search alone would take half of a hundredth of a second, at every start
    said = (name for name, source in texts.items() if b"numba" in source or b"twin.compiled" in source)
    compiled = {_room(name) for name in said if COMPILES.search(texts[name])}
    digest = hashlib.sha256()
    for name, source in texts.items():
        if not _room(name) or _room(name) in compiled:
            digest.update(name.encode() + b"\0" + source + b"\0")
    return digest.hexdigest()[:16]


def _room(name: str) -> str:
    """The sub-package of a file, "" of one above them."""
    return name.partition(os.sep)[0] if os.sep in name else ""


@cache
def use_cache() -> Path:
    """Point numba at this source's own folder; keep the newest few, drop older ones. Once is enough.

    Where the package's own folder is not the user's alone, they are in the user's cache folder; where there is none,
    nothing is kept beyond this process and those that it starts.
    """
    package = Path(__file__).parents[1]
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        # of the process that started this one, or the user's own choice, which is left alone
        folder = Path(given)
        if is_own(folder):
            use_seals(folder)
        return folder
    try:
        folder = _made(_home(package), source_digest(package))
    except InputRefused as refusal:
        _refusal.append(str(refusal))
        folder = _passing()
    else:
        use_seals(folder)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder


def refusal() -> str:
    """Why nothing that is compiled is kept, as a sentence; "" if it is."""
    return "".join(_refusal)


def is_own(folder: Path) -> bool:
    """Whether `folder` is one of those that `use_cache` chooses, and not the user's own choice."""
    if folder.parent == compiled_home(Path(__file__).parents[1]):
        return True
    try:
        return folder.parent == cache_base() / NAME
    except InputRefused:
        return False


def compiled_home(package: Path) -> Path:
    """Beside `package`: where the folders of all its sources are if that is the user's alone."""
    return package / "__pycache__" / NAME


def _home(package: Path) -> Path:
    """Of the folders of all sources: beside the package, or in the user's cache folder.

    Raises:
        InputRefused: neither is the user's alone.
    """
    try:
        return private_folder(compiled_home(package))
    except InputRefused:
        return cache_folder(NAME)


def _made(home: Path, digest: str) -> Path:
    """The folder of the source with this digest, held and fit for use.

    Raises:
        InputRefused: it cannot be made.
    """
    folder = home / digest
    with disk_refusals(folder, kind=InputRefused, remedy=REMEDY):
        discard_foreign(folder)
        if not folder.is_dir():
            if folder.exists():
                remove(folder)
            folder.mkdir(PRIVATE, exist_ok=True)
            evict(home, KEPT)
        hold(folder)
        for module in os.scandir(folder):
            # numba's are folders; where it cannot write it would go to another place that is never cleared
            if not module.is_dir() or not os.access(module, os.R_OK | os.W_OK | os.X_OK):
                # another process may be first
                with contextlib.suppress(FileNotFoundError):
                    remove(Path(module.path))
    return folder


def _passing() -> Path:
    """A folder that goes with this process."""
    import atexit
    import shutil
    import tempfile

    folder = Path(tempfile.mkdtemp(prefix="twin-native-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
