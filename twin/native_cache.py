"""Where compiled code is kept between processes.

Numba checks only the file of a cached function itself: after an edit of `robot/jacobian.py` it would go on using the
old machine code inlined into `plant/`. So the folder is named after the content of all source that compiled code may
be made of: every sub-package in which some file imports numba, and the files above them. Floors that compiled code
stands on hold compiled code themselves, or nothing that it freezes.
"""

import hashlib
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

KEPT = 3
COMPILES = re.compile(rb"^(from|import) numba\b", re.MULTILINE)


def source_digest(package: Path) -> str:
    """Hash over the names and the content of the Python files of `package` that compiled code is made of."""
    sources = {file.relative_to(package): file.read_bytes() for file in sorted(package.rglob("*.py"))}
    compiled = {name.parts[0] for name, source in sources.items() if COMPILES.search(source)}
    digest = hashlib.sha256()
    for name, source in sources.items():
        if len(name.parts) == 1 or name.parts[0] in compiled:
            digest.update(str(name).encode() + b"\0" + source + b"\0")
    return digest.hexdigest()[:16]


def _home(package: Path) -> Path:
    beside = package / "__pycache__"
    if os.access(beside if beside.exists() else package, os.W_OK):
        return beside / "native"
    return Path(tempfile.gettempdir()) / f"twin-native-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def use_cache() -> None:
    """Point numba at this source's own folder; keep the newest few, drop older ones."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    package = Path(__file__).parent
    home = _home(package)
    folder = home / source_digest(package)
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(home.iterdir(), key=lambda f: f.stat().st_mtime, reverse=True)
        for old in others[KEPT:]:
            shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
