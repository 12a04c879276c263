"""The walk of docs/explore.md, recorded: explore.gif, a frame a step, and explore.png, one of them.

`python docs/builder/explorer_walk.py FOLDER` prints the numbers of each step: those that docs/explore.md names.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

SPRING = "robot.k_s_Nm_per_rad"
SIZE = {"width": 1200, "height": 800}
WIDE = 900
"""Pixels of the recorded walk."""
FRAME = 2500
"""ms a frame stands."""


class Walk:
    """The page and the frames taken of it."""

    def __init__(self, page: Page):
        self.page, self.frames = page, list[Image.Image]()
        self.began = time.perf_counter()

    def type(self, key: str, text: str) -> None:
        """A value, as a hand would set it."""
        field = self.page.locator(f".setting[data-key='{key}'] .entry input")
        field.fill(text)
        field.press("Enter")

    def take(self, caption: str) -> None:
        """A frame of the step that has this caption, when its answers are there."""
        self.page.wait_for_timeout(1500)
        numbers = [" ".join(text.split()) for text in self.page.locator(".box").all_inner_texts()[:3]]
        print(f"{time.perf_counter() - self.began:5.1f} s  {caption}: {'; '.join(numbers)}")
        self.page.evaluate("text => (document.getElementById('out').textContent = text)", caption)
        self.frames.append(Image.open(BytesIO(self.page.screenshot())).convert("RGB"))


def walk(page: Page) -> list[Image.Image]:
    """The steps of docs/explore.md; the second frame is its picture."""
    page.locator(".plot canvas").first.wait_for()
    now = Walk(page)
    now.take("1  Fig. 4 as the file has it")
    page.click("#pin")
    for value, words in (("3", "a stiffer spring"), ("0.5", "the best one")):
        now.type(SPRING, value)
        now.take(f"2  {words}: {value} N m/rad, with the file's beside it")
    page.get_by_label(re.compile("^Remove")).click()
    page.select_option("#layout", "fig4")
    now.take("3  The same as the paper's Fig. 4")
    page.click("#score summary")
    page.locator("#score tbody tr").first.wait_for()
    page.locator("#score").scroll_into_view_if_needed()
    page.evaluate("document.getElementById('score').scrollIntoView({ behavior: 'instant' })")
    now.take("4  Does a claim of the paper turn over?")
    page.click("#score summary")
    page.evaluate("scrollTo({ top: 0, behavior: 'instant' })")
    page.select_option("#body", "forearm")
    now.take("5  On a softer body")
    return now.frames


def main(out: Path) -> None:
    """Write both files into the folder `out`."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        command = [sys.executable, "-m", "twin", "explore", "fig4_force_position", "--no-browser", "--port", "0"]
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=SIZE)
        page.goto(found.group())
        frames = walk(page)
        browser.close()
        process.terminate()
        process.wait()
    frames[1].quantize(128).save(out / "explore.png", optimize=True)
    small = [frame.resize((WIDE, WIDE * frame.height // frame.width), Image.Resampling.LANCZOS) for frame in frames]
    palette = [frame.quantize(128, Image.Quantize.MAXCOVERAGE) for frame in small]
    first, *others = palette
    first.save(out / "explore.gif", save_all=True, append_images=others, duration=FRAME, loop=0, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
