"""Where compiled code is kept between processes.

Numba checks only the file of a cached function itself: after an edit of `robot/jacobian.py` it would go on using the
old machine code inlined into `plant/`. So the folder is named after the content of every source file of the package.
"""

import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

KEPT = 3


def source_digest(package: Path) -> str:
    """Hash over the names and the content of all Python files of `package`."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + b"\0" + file.read_bytes() + b"\0")
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
