"""docs/recording.md names the fields that a recording has."""

import re
from pathlib import Path

from twin.kernel.recording.reader import Recording

ROW = re.compile(r"^\| `([^`]+)` \| (\d+) \| ([^|]+) \| (.+) \|$", re.MULTILINE)


def test_the_page_has_the_fields_of_fig_4_with_size_unit_and_meaning(root: Path, force_position: Recording):
    written = [(name, int(size), unit, meaning) for name, size, unit, meaning in ROW.findall(_page(root))]
    # the three drives are one FMU: the page has the first one's fields
    fields = {
        name: field for name, field in force_position.fields().items() if not name.startswith(("drive/2", "drive/3"))
    }
    assert written == [(name, field.size, field.unit, field.meaning) for name, field in fields.items()]


def _page(root: Path) -> str:
    return (root / "docs" / "recording.md").read_text()
