"""`twin explore` as a program, and its page in a browser."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from playwright.sync_api import Locator, Page

from twin.kernel.process.process import environment

SPRING = "robot.k_s_Nm_per_rad"
GAIN = "controller.force.kp_mm_per_N"
FORCE = "hold error"
READY = 60.0
"""How long (s) it may take to begin: compiled code may be missing."""


class Explorer:
    """The program, in a folder of its own; a context manager that ends it.

    Args:
        folder: where it is started.
        words: behind `twin explore`.
        port: 0: any that is free.

    Attributes:
        address: with the token, as it is printed.
        origin: of its pages.
    """

    def __init__(self, folder: Path, *words: str, port: int = 0):
        command = [sys.executable, "-m", "twin", "explore", *words, "--no-browser", "--port", str(port)]
        self.process = subprocess.Popen(
            command, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + self.process.stdout.read()
        self.address = found.group()
        self.origin = self.address.partition("/?")[0]

    @property
    def port(self) -> int:
        return int(self.origin.rpartition(":")[2])

    def __enter__(self) -> "Explorer":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.kill(signal.SIGINT)

    def kill(self, how: int = signal.SIGKILL) -> int:
        """End it; its exit code."""
        if self.process.poll() is None:
            os.kill(self.process.pid, how)
        code = self.process.wait(READY)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


def wait_until(page: Page, condition: str, argument: object = None) -> None:
    """Until a function of JavaScript says so; the page's policy lets nothing evaluate it there again and again."""
    deadline = time.monotonic() + 30.0
    while not page.evaluate(condition, argument):
        assert time.monotonic() < deadline, condition
        page.wait_for_timeout(20)


class Opened:
    """The page, and what its console said."""

    def __init__(self, page: Page, address: str):
        self.page = page
        self.messages: list[str] = []
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.goto(address)
        self.wait()

    def wait(self) -> None:
        """Until the first picture is there."""
        self.page.locator(".plot canvas").first.wait_for()
        self.page.locator(".box").first.wait_for()

    def row(self, key: str) -> Locator:
        return self.page.locator(f".setting[data-key='{key}']")

    def number(self, name: str) -> str:
        return self.page.locator(".box", has_text=name).first.locator("strong").inner_text()

    def type(self, key: str, text: str) -> None:
        """Type a value and wait for its picture, or its refusal."""
        field = self.row(key).locator(".entry input")
        before = self.answers()
        field.fill(text)
        field.press("Enter")
        wait_until(
            self.page,
            "n => performance.getEntriesByName('twin-follow').length > n"
            " || document.getElementById('picture').classList.contains('old')",
            before,
        )

    def answers(self) -> int:
        found: int = self.page.evaluate("performance.getEntriesByName('twin-follow').length")
        return found

    def drag(self, key: str, start: float, end: float, steps: int = 20) -> None:
        """Move a slider's thumb from one share of its length to another."""
        box = self.row(key).locator("input[type=range]").bounding_box()
        assert box is not None
        y = box["y"] + box["height"] / 2
        self.page.mouse.move(box["x"] + box["width"] * start, y)
        self.page.mouse.down()
        for step in range(1, steps + 1):
            self.page.mouse.move(box["x"] + box["width"] * (start + (end - start) * step / steps), y)
            self.page.wait_for_timeout(30)
        self.page.mouse.up()
