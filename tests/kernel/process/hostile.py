"""The drive of hostile.c, and `twin run` with it as a user types it."""

import os
import re
import subprocess
import sys
import uuid
from dataclasses import dataclass
from pathlib import Path

from tests.command_line import process_run
from tests.kernel.fmi.compiled import compiled_drive

SOURCE = Path(__file__).with_name("hostile.c")
EXPERIMENT = "experiments/fig4_position.toml"
# the order of the enumeration in hostile.c
NONE, SEGFAULT, ABORT, EXIT, HANG, HANG_IN_INITIALISATION, SEGFAULT_IN_FREE, FLOOD, MOVE, LEAK, FORK = range(11)


def hostile_drive(root: Path, folder: Path) -> Path:
    """The FMU, built in `folder`."""

    def honest(text: str) -> str:
        return re.sub(r"fmi2(FreeInstance|ExitInitializationMode)\(", r"honest_\1(", text)

    return compiled_drive(root, folder, "hostile", {"model.c": SOURCE.read_text(), "lifecycle.c": honest})


@dataclass
class Command:
    """`twin` in a folder of its own, with a mark that all of its descendants inherit."""

    root: Path
    folder: Path

    def __post_init__(self) -> None:
        self.token = uuid.uuid4().hex
        self.scratch = self.folder / "scratch"
        self.scratch.mkdir()

    def arguments(self, drive: Path, attack: int, *more: str) -> list[str]:
        """`twin run` in which joint 2 has the hostile drive."""
        settings = ["duration_s=2", f"drive.joint_2.fmu='{drive}'", f"drive.joint_2.parameters.droop={attack}"]
        flags = [part for setting in settings for part in ("--set", setting)]
        command = [sys.executable, "-m", "twin", "run", str(self.root / EXPERIMENT), "--out", "x"]
        return [*command, *flags, *more]

    @property
    def environment(self) -> dict[str, str]:
        own = {"TWIN_TEST_TOKEN": self.token, "TMPDIR": str(self.scratch), "TWIN_CACHE": str(self.folder / "cache")}
        return {**os.environ, **own}

    def run(self, drive: Path, attack: int, *more: str) -> subprocess.CompletedProcess[str]:
        command = self.arguments(drive, attack, *more)
        return process_run(command, cwd=self.folder, env=self.environment, timeout=120)

    def survivors(self) -> list[str]:
        """Command lines of processes that this command has left behind."""
        left = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if self.token.encode() in (process / "environ").read_bytes():
                    left.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode())
            # it ended while we looked
            except OSError:
                pass
        return left

    def leftovers(self) -> list[str]:
        """What was left in the folder for temporary files, and of unfinished unpacking."""
        return [path.name for path in [*self.scratch.iterdir(), *(self.folder / "cache" / "unpacked").glob(".*")]]
