"""Curves of a run small enough to be kept in its row: every 40 ms, as text.

In the row they are as safe as the row is: no engine, crash or resumed sweep can part the two. They bring their names
and their period along, so that rows of another version are not misread.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of, values_of

PERIOD = 0.04
"""Between two samples (s): 500 of the 20 s of Fig. 4, about one per pixel of a panel."""


def packed(curves: Mapping[str, tuple[Curve, Curve]], end: float) -> dict[str, Any]:
    """`curves` for JSON as they are at 0, `PERIOD`, ... up to `end` (s), on lines between their samples.

    Args:
        curves: (times (s), values), each (n,), by name; times ascend.
    """
    t = np.arange(int(end / PERIOD + 1e-9) + 1) * PERIOD
    return {"period_s": PERIOD, "of": {name: text_of(np.interp(t, *curve)) for name, curve in curves.items()}}


def unpacked(kept: Mapping[str, Any]) -> tuple[Curve, dict[str, Curve]]:
    """(times (s), values by name) of what `packed` made.

    Raises:
        ValueError: it did not make this.
    """
    try:
        values = {name: values_of(text) for name, text in kept["of"].items()}
    except KeyError as problem:
        raise ValueError(str(problem)) from None
    if len({len(curve) for curve in values.values()}) != 1:
        raise ValueError("curves of different lengths")
    samples = len(next(iter(values.values())))
    t: Curve = np.arange(samples, dtype=float) * float(kept["period_s"])
    return t, values
