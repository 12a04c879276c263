"""What has to be the same on two machines for a run to give the same bits there."""

import functools
import hashlib
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import twin

PACKAGES = ("numba", "llvmlite", "numpy", "fmpy")


@functools.cache
def versions() -> dict[str, str]:
    """Of this process, by what a user would call it.

    twin's is followed by a hash of its files: in a clone the number stays while the code changes.
    """
    return {
        "twin": f"{_version('twin')} (files {_digest(Path(twin.__file__).parent)})",
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        **{package: _version(package) for package in PACKAGES},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def difference(who: str, theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """`tcp://10.0.0.5:4001 has numba 0.59.1, this machine has 0.61.0`; "" if they are the same."""
    told = [
        f"{what} {theirs.get(what, 'none')}, this machine has {own}"
        for what, own in ours.items()
        if theirs.get(what) != own
    ]
    return f"{who} has {'; and '.join(told)}" if told else ""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _digest(folder: Path) -> str:
    content = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        content.update(f"{file.relative_to(folder).as_posix()}\0".encode())
        content.update(file.read_bytes())
    return content.hexdigest()[:8]
