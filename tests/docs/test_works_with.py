"""The count of FMUs by tool is that of the survey's data."""

import json
import re
from collections import Counter
from pathlib import Path

WORDS = ("agrees", "ran", "differs", "refused", "failed", "lost")


def test_the_table_counts_the_fmus_of_the_survey(root: Path):
    rows = re.findall(r"^\| ([^|]+) \|((?: \d* \|){6})$", (root / "docs/works_with.md").read_text(), re.MULTILINE)
    told = {name: [int(cell.strip() or 0) for cell in cells.split("|")[:-1]] for name, cells in rows}
    families = [name for name in told if name not in ("others", "not stated")]
    counts: dict[str, Counter[str]] = {name: Counter() for name in told}
    for fmu in json.loads((root / "docs/compatibility.json").read_text())["fmus"]:
        tool = fmu.get("tool") or ""
        family = next((name for name in families if name in tool), "others" if tool else "not stated")
        counts[family][fmu["word"]] += 1
    assert told == {name: [counts[name][word] for word in WORDS] for name in counts}
