"""The page of a hazard table on a phone."""

from pathlib import Path

from playwright.sync_api import Browser

from twin.studies.safety.hazards import read_hazards
from twin.studies.safety.page import _table, hazard_page


def test_wide_tables_of_the_safety_page_scroll_in_their_own_box(browser: Browser, root: Path):
    wide = _table(["head"] * 8, [["<code>twin run --set a.b=1</code>"] * 8])
    html = hazard_page(
        read_hazards(root / "experiments" / "safety" / "massage.toml"), (), (), "twin safety " + "x" * 100
    )
    phone = browser.new_page(viewport={"width": 390, "height": 844})
    phone.set_content(html.replace("</body>", f'<div class="runs">{wide}</div></body>'))
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    assert phone.evaluate("getComputedStyle(document.querySelector('.runs table')).overflowX") == "auto"
    phone.close()
