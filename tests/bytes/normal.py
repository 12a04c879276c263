"""What may differ between two runs of the same command, and what is written in its place."""

import re
from collections.abc import Mapping

NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"

RULES: tuple[tuple[str, str], ...] = (
    # said only where code is not compiled yet
    (r"compiling, once: [^\n]*\n?", ""),
    # moments
    (r"\d{4}-\d\d-\d\d[ _T]\d\d:?\d\d(:?\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?", "TIME"),
    # how long it took, in text, JSON and pages
    (rf"{NUMBER} x real time", "N x real time"),
    (rf'("(?:stepping|writing|stepping_s|recording_s|real_time_factor|cost_us\w*)": ){NUMBER}', r"\1N"),
    (r'"microseconds": \{[^}]*\}', '"microseconds": {N}'),
    (
        r'(<th scope="row">(?:stepping|recording|times as fast as the real robot|[^<]*per tick)</th>)(\s*<td>[^<]*</td>)+',
        r"\1<td>N</td>",
    ),
    # what a run takes on the disk, with durations in its summary
    (r'"bytes": \d+', '"bytes": N'),
    # of the machine: what is free, what caches hold
    (rf"{NUMBER} (?=GB free)", "N "),
    (r"\d+ (FMUs?|files?|folders?|functions?|pieces of code), \d+ MB", r"N \1, N MB"),
)
"""Regular expressions, and what stands for what they find."""


class Normal:
    """Writes a text so that it is the same whenever and wherever it is made.

    Args:
        places: names of folders, by their paths; they are as long in one tree as in the other, so that lines are
            broken where they were.
    """

    def __init__(self, places: Mapping[str, str]):
        self._places = sorted(places.items(), key=lambda item: -len(item[0]))

    def text(self, text: str) -> str:
        """`text` without what may differ."""
        for path, name in self._places:
            text = text.replace(path, name)
        for pattern, instead in RULES:
            text = re.sub(pattern, instead, text)
        return text
