"""A Python of our own: it finds this package and nothing that happens to lie in the folder where it is started."""

import os
import sys
import sysconfig
from pathlib import Path

import twin


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs `module` of this package, with `environment`."""
    # -P: the folder where a user happens to be is no place to import from
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """This process's environment, by which another Python finds the package that this one uses."""
    home = str(Path(twin.__file__).parents[1])
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    # an empty entry is the current folder; site-packages are found anyway, and not before the standard library
    paths = [path for path in (home, *inherited) if path and path != sysconfig.get_path("purelib")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
