"""Redirects from the addresses of pages that were merged into other pages."""

import json
import re
from pathlib import Path

MOVED_PAGES = {
    "analysis": "tuning",
    "analysis_method": "loops",
    "cluster": "sweep",
    "convergence": "validation",
    "drives_method": "drives_reference",
    "export_c": "export_fmu",
    "export_fmu_reference": "ssp_reference",
    "export_masters": "export_fmu",
    "extending": "building",
    "falsify": "faults",
    "fig4": "paper",
    "fig5": "paper",
    "from_python": "ssp",
    "kernel": "ssp",
    "live": "report",
    "paper_errata": "paper",
    "performance": "building",
    "python_reference": "python",
    "replay": "compare",
    "roles_reference": "roles",
    "ros2": "export",
    "shadow_method": "shadow_reference",
    "shadow_method#the-state": "identification_method",
    "shadow_method#what-cannot-be-known": "identification_method",
    "small_effects": "physics",
    "sweep_show": "sweep",
    "tasks_method": "control",
    "testing": "building",
    "tuning_method": "loops",
    "viewers": "report",
    "why_believe": "validation",
}
"""Old page, or "page#id" for an id that moved elsewhere -> page that has its text.

The section with the text of an old page has its name as id."""

ID = re.compile(r'\bid="([^"]+)"')
REDIRECT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Moved</title>
<meta name="robots" content="noindex">
<noscript><meta http-equiv="refresh" content="0; url={section}"></noscript>
<p>This page moved to <a href="{section}">{section}</a>.</p>
<script>
const places = {places};
const id = decodeURIComponent(location.hash.slice(1));
location.replace(Object.hasOwn(places, id) ? places[id] : "{section}");
</script>
</html>
"""


def redirect_page(page: str, site: Path) -> str:
    """Return the HTML that sends a reader of the old `page` to the same id of its new page, or to its section.

    Args:
        page: name without suffix.
        site: folder of the built site.
    """
    target = MOVED_PAGES[page]
    places = {found: f"{target}.html#{found}" for found in page_ids(site, target)}
    # an id that two merged pages shared bears the name of its old page
    own = f"{page}-"
    places |= {found.removeprefix(own): place for found, place in places.items() if found.startswith(own)}
    for key, other in MOVED_PAGES.items():
        if key.startswith(f"{page}#"):
            found = key.partition("#")[2]
            places[found] = f"{other}.html#{found}"
    return REDIRECT.format(section=f"{target}.html#{page}", places=json.dumps(places))


def page_ids(site: Path, page: str) -> list[str]:
    """Return the ids of the headings of a page of the site that an address may name."""
    return [found for found in ID.findall((site / f"{page}.html").read_text(encoding="utf-8")) if found[:2] != "__"]
