"""The panels with their samples, as the page's scripts read them."""

from collections.abc import Sequence
from typing import Any

from twin.report.page.block import Block, thinned, thinning
from twin.report.page.panels import Samples, panels
from twin.report.page.run import ReportRun

MOST_SAMPLES = 4_000_000
"""In a page: about 4 MB, and a dozen milliseconds of decoding."""


def curves(runs: Sequence[ReportRun], blocks: Sequence[Block]) -> tuple[list[dict[str, Any]], int]:
    """(panels for JSON, factor by which samples are thinned); the samples of each run go into its block.

    A curve is [first sample in the block, number, time of the first (s), time from one to the next (s)]; null where a
    run does not have it.
    """
    found = [
        (panel, [(quantity, [quantity.read(run) for run in runs]) for quantity in panel.quantities])
        for panel in panels(runs)
    ]
    total = sum(len(one[0]) for _, rows in found for _, samples in rows for one in samples if one)
    factor = thinning(total, MOST_SAMPLES)
    facts = [
        {
            "title": panel.title,
            "unit": "" if panel.unit == "1" else panel.unit,
            "rows": [
                {
                    "label": quantity.label,
                    "role": quantity.role,
                    "member": quantity.member,
                    "shown": quantity.shown and (len(runs) == 1 or quantity.role in ("truth", "reference")),
                    "curves": [_curve(one, block, factor) for one, block in zip(samples, blocks, strict=True)],
                }
                for quantity, samples in rows
                if any(samples)
            ],
        }
        for panel, rows in found
    ]
    return facts, factor


def _curve(samples: Samples | None, block: Block, factor: int) -> list[float] | None:
    if samples is None:
        return None
    t, values = samples
    step = float(t[-1] - t[0]) / max(1, len(t) - 1)
    return [*block.add(thinned(values, factor)), float(t[0]), step * factor]
