"""What a wheel leaves out: files put beside those of the repository, an experiment of the user's own say.

And what `make wheel` brings in: machine code.
"""

import os
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHIPPED = ("twin", "examples", "experiments", "fmus", "tests/baselines")
OBJECTS = "TWIN_OBJECTS"
"""Variable that names the folder of machine code that `build_wheel.py` made, for Linux on x86-64."""


class Untracked(BuildHookInterface):
    """Excludes from a wheel what git does not know, and includes machine code that was made for it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before the files are gathered; `version`: "standard" or "editable"."""
        if version == "editable":
            return
        if folder := os.environ.get(OBJECTS):
            build_data["force_include"][folder] = "twin/kernel/compiled/objects"
            build_data["pure_python"], build_data["tag"] = False, "py3-none-linux_x86_64"
        try:
            # a source distribution may lie in somebody else's repository, which knows none of its files
            if not Path(self.root).samefile(self._git("rev-parse", "--show-toplevel").rstrip("\n")):
                return
            others = self._git("ls-files", "--others", "-z", "--", *SHIPPED)
        # no git, or no repository
        except (OSError, subprocess.CalledProcessError):
            return
        excluded = self.build_config.target_config.setdefault("exclude", [])
        # as patterns of .gitignore, in which these characters mean something
        excluded += [
            "/" + "".join(f"\\{c}" if c in "\\*?[]!# " else c for c in name) for name in others.split("\0") if name
        ]

    def _git(self, *words: str) -> str:
        return subprocess.run(["git", *words], cwd=self.root, capture_output=True, check=True, text=True).stdout
