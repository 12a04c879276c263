"""What `make` runs to install twin and what it needs: pip, with one line for what it is doing instead of a page."""

import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from subprocess import PIPE, STDOUT

EXPECTED = {"explore": (52, 202), "test,docs": (108, 390)}
"""Extras -> about how many packages that is, and how many MB to download. Of others nothing is foretold."""
FETCHED = re.compile(
    r"(?:Downloading|Using cached|Processing) (\S+\.(?:whl|tar\.gz))(?=\s|$)(?: \(([\d.]+) ([kM])B\))?"
)
BAR = 24
PERIOD = 0.2
"""Seconds between two looks of the line."""


class Progress:
    """What pip has said so far.

    Attributes:
        packages, megabytes: fetched. current: what it is busy with.
    """

    def __init__(self) -> None:
        self.packages, self.megabytes, self.current = 0, 0.0, "asking for packages"
        self.last: deque[str] = deque(maxlen=20)

    def take(self, line: str) -> None:
        """A line of pip's output."""
        self.last.append(line)
        fetched = FETCHED.match(line.strip())
        if fetched:
            self.packages += 1
            self.megabytes += float(fetched[2] or 0) * (1e-3 if fetched[3] == "k" else 1.0)
            self.current = Path(fetched[1]).name.partition("-")[0]
        elif line.startswith("Installing collected packages"):
            self.current = "unpacking"

    def listen(self, lines: Iterable[str]) -> None:
        """Take `lines` until there are no more."""
        for line in lines:
            self.take(line.rstrip())

    def text(self, packages: int, seconds: float) -> str:
        """One line of less than 80 columns; `packages`: about how many there will be, 0 if nobody knows."""
        unpacking = self.current == "unpacking"
        share = 1.0 if unpacking else min(self.packages / packages, 0.99) if packages else 0.0
        bar = f"[{'#' * int(share * BAR):{BAR}}] " if packages else ""
        of = "" if unpacking or not packages else f" of about {packages}"
        size = f", {self.megabytes:.0f} MB" if self.megabytes else ""
        return f"  {bar}{self.packages}{of} packages{size}, {seconds:.0f} s: {self.current}"[:79]


def main() -> int:
    """Install the repository with the extras of the command line; the exit code is pip's."""
    extras = sys.argv[1] if len(sys.argv) > 1 else ""
    packages, megabytes = EXPECTED.get(extras, (0, 0))
    size = f" (about {megabytes} MB if none is here yet)" if megabytes else ""
    print(f"Setting up, once: downloading packages{size} and installing them in {sys.prefix}", flush=True)
    wanted = f".[{extras}]" if extras else "."
    command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
    if not sys.dont_write_bytecode:
        # of 8000 modules a third is ever imported, and compiled then
        command += ["--no-compile"]
    command += ["-c", "constraints.txt", "-e", wanted]
    pip = subprocess.Popen(command, stdout=PIPE, stderr=STDOUT, encoding="utf-8", errors="replace")
    progress, began = Progress(), time.monotonic()
    reader = threading.Thread(target=progress.listen, args=(pip.stdout,))
    reader.start()
    while pip.poll() is None:
        if sys.stdout.isatty():
            print(f"\r{progress.text(packages, time.monotonic() - began):79}", end="", flush=True)
        time.sleep(PERIOD)
    reader.join()
    if sys.stdout.isatty():
        print(f"\r{'':79}\r", end="", flush=True)
    if pip.returncode:
        print("\n".join(progress.last), file=sys.stderr)
    else:
        print(f"Set up: {progress.packages} packages fetched, {time.monotonic() - began:.0f} s")
    return pip.returncode


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("\ninterrupted; the next make goes on")
