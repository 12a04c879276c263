"""Curves of a run small enough to be kept in its row: every 40 ms, as 32 bit floats, deflated, in base 64.

In the row they are as safe as the row is: no engine, crash or resumed sweep can part the two. They bring their names
and their period along, so that rows of another version are not misread.
"""

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.studies.metrics.response import Curve

PERIOD = 0.04
"""Between two samples (s): 500 of the 20 s of Fig. 4, about one per pixel of a panel."""
LARGEST = 4_000_000
"""Bytes of a curve: a million samples, eleven hours."""
LEVEL = 6
"""Of zlib: higher ones take twice as long for one percent."""


def packed(curves: Mapping[str, tuple[Curve, Curve]], end: float) -> dict[str, Any]:
    """`curves` for JSON as they are at 0, `PERIOD`, ... up to `end` (s), on lines between their samples.

    Args:
        curves: (times (s), values), each (n,), by name; times ascend.
    """
    t = np.arange(int(end / PERIOD + 1e-9) + 1) * PERIOD
    return {"period_s": PERIOD, "of": {name: _text(np.interp(t, *curve)) for name, curve in curves.items()}}


def unpacked(kept: Mapping[str, Any]) -> tuple[Curve, dict[str, Curve]]:
    """(times (s), values by name) of what `packed` made.

    Raises:
        ValueError: it did not make this.
    """
    try:
        values = {name: _values(text) for name, text in kept["of"].items()}
    except (zlib.error, KeyError) as problem:
        raise ValueError(str(problem)) from None
    if len({len(curve) for curve in values.values()}) != 1:
        raise ValueError("curves of different lengths")
    samples = len(next(iter(values.values())))
    t: Curve = np.arange(samples, dtype=float) * float(kept["period_s"])
    return t, values


def _text(values: Curve) -> str:
    # neighbours differ in their low bits only: bytes of like weight side by side are deflated to a half
    steps = np.diff(values.astype("<f4").view("<u4"), prepend=np.uint32(0))
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, 4).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), LEVEL)).decode("ascii")


def _values(text: str) -> Curve:
    deflated = zlib.decompressobj()
    planes = np.frombuffer(deflated.decompress(base64.b64decode(text), LARGEST), np.uint8).reshape(4, -1)
    steps = np.ascontiguousarray(planes.T).view("<u4")[:, 0]
    return np.asarray(np.cumsum(steps, dtype="<u4").view("<f4"), dtype=np.float64)
