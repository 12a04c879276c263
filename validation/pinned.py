"""Files of public repositories, pinned by commit and hash; they are read out of a clone and are no part of the twin."""

import os
import subprocess
import tomllib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from validation.yardstick import NotHere

LIST = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True)
class PinnedFiles:
    """Files of a commit.

    Attributes:
        repository: owner and name on GitHub.
        variable: of the environment, that names a clone.
        commit: the whole hash.
        files: SHA-256 by path.
    """

    repository: str
    variable: str
    commit: str
    files: Mapping[str, str]

    def content(self, path: str) -> bytes:
        """Of one of the files.

        Raises:
            NotHere: no clone is named in the environment, or it does not have the file.
            RuntimeError: the file is another one.
        """
        clone = os.environ.get(self.variable)
        if not clone:
            raise NotHere(f"make validation {self.variable}=a clone of {self.repository}")
        asked = ["git", "-C", clone, "show", f"{self.commit}:{path}"]
        found = subprocess.run(asked, capture_output=True, check=False)
        if found.returncode:
            raise NotHere(f"the clone of {self.repository} has no {path} of commit {self.commit[:12]}")
        if sha256(found.stdout).hexdigest() != self.files[path]:
            raise RuntimeError(f"{path} has another SHA-256 than {self.files[path][:12]}")
        return found.stdout

    def packed(self, folder: str, file: Path) -> Path:
        """`file`, an archive of the files below a folder; raises as `content`."""
        inside = {path.removeprefix(f"{folder}/"): path for path in self.files if path.startswith(f"{folder}/")}
        contents = {name: self.content(path) for name, path in inside.items()}
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in contents.items():
                archive.writestr(name, content)
        return file


def pinned(name: str) -> PinnedFiles:
    """What a table of pinned.toml says."""
    return PinnedFiles(**tomllib.loads(LIST.read_text(encoding="utf-8"))[name])
