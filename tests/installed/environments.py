"""Environments with twin installed as a user would, but for what it needs, which is that of this one."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

BUILD = "import sys; from hatchling import build; print(getattr(build, sys.argv[1])(sys.argv[2]))"
ELSEWHERE = [path for path in sys.path if Path(path).name == "site-packages"]


@dataclass(frozen=True)
class Environment:
    """A virtual environment in `folder`."""

    folder: Path

    def run(self, program: str, *arguments: object, cwd: Path, code: int = 0) -> str:
        """What `program` of the environment prints, on both ways; it has to end with the exit code `code`."""
        inherited = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
        done = subprocess.run(
            [self.folder / "bin" / program, *map(str, arguments)],
            cwd=cwd, env=inherited, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=600,
        )  # fmt: skip
        assert done.returncode == code, done.stdout
        return done.stdout


def built(root: Path, hook: str, folder: Path) -> Path:
    """What the build backend's `hook` makes of the repository, in `folder`."""
    command = [sys.executable, "-c", BUILD, hook, str(folder)]
    done = subprocess.run(command, cwd=root, stdout=subprocess.PIPE, text=True, check=True)
    return folder / done.stdout.split()[-1]


def installed(wheel: Path, folder: Path) -> Environment:
    """A new environment in `folder` with `wheel`; nothing is downloaded."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", "--disable-pip-version-check", str(wheel)], check=True)
    (packages,) = folder.glob("lib/*/site-packages")
    # after those of the environment itself
    (packages / "elsewhere.pth").write_text("\n".join(ELSEWHERE) + "\n")
    return Environment(folder)
