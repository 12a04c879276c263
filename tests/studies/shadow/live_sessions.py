"""Sessions of `twin shadow --live` beside the log of a robot of which a spring has become softer."""

import re
import signal
import subprocess
import sys
from pathlib import Path
from types import TracebackType

from tests.studies.replay.logs import EXPERIMENTS, FIG4, SCALE, ran, softened
from twin.kernel.process.process import environment
from twin.kernel.recording.reader import Recording, read

ROBOT = EXPERIMENTS / f"{FIG4}.toml"
SPRING = 0.85
"""N m/rad, of joint 2, from 1 s on; the twin believes 1."""
FLEET = f"""
experiment = "{ROBOT}"
design     = "latin_hypercube"
runs       = 2
seed       = 35
[[vary]]
key  = "contact.stiffness_N_per_m"
from = 1000
to   = 1500
"""
"""Two healthy robots are quickly there, and enough for an alarm of such a spring."""


class SoftRobot:
    """The command as a program, in a process of its own; a context manager that ends it.

    Args:
        folder: of the fleet and the recording.
        speed: pace of the log, 40 s long; the proposal is there at 14.5 s.

    Attributes:
        address: with the token.
        recording: folder of the session.
    """

    def __init__(self, folder: Path, speed: float):
        (folder / "fleet.toml").write_text(FLEET)
        log = ran(FIG4, softened((2,), 1.0, SPRING), "duration_s=40").path
        self.recording = folder / "session"
        words = ["--source", str(log), "--speed", str(speed), "--fleet", str(folder / "fleet.toml")]
        words += [word for setting in SCALE for word in ("--set", setting)]
        words += ["--live", "--port", "0", "--out", str(self.recording)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twin", "shadow", str(ROBOT), *words], env=environment(),
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stderr is not None
        text = ""
        while not (found := re.search(r"ws://\S+\?token=[\w-]+", text)):
            line = self.process.stderr.readline()
            assert line, text
            text += line
        self.address = found.group()

    def __enter__(self) -> "SoftRobot":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.process.kill()
        self.process.communicate()

    def end(self) -> Recording:
        """Ctrl-C: what it has recorded."""
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=60)
        return read(self.recording)
