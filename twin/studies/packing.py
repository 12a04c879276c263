"""Compact text for samples: 32 bit floats, deflated (RFC 1950), in base 64.

Their bit patterns, taken as integers, are replaced by differences of neighbours, and the bytes of like weight are put
side by side: neighbours differ in their low bits only, and the whole takes a third of what the floats alone would.
Nothing but the rounding to 32 bits is lost. The scripts of a page read the same.
"""

import base64
import zlib

import numpy as np

from twin.studies.metrics.response import Curve

MAX_BYTES = 4_000_000
"""Bytes that are unpacked at most: a million samples, eleven hours of a curve in a sweep."""
COMPRESSION_LEVEL = 6
"""Of zlib: higher ones take twice as long for one percent."""


def text_of(values: Curve) -> str:
    """`values` (n,) as text; the same values are the same text."""
    steps = np.diff(values.astype("<f4").view("<u4"), prepend=np.uint32(0))
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, 4).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), COMPRESSION_LEVEL)).decode("ascii")


def values_of(text: str) -> Curve:
    """The values (n,) that `text_of` made `text` of.

    Raises:
        ValueError: it did not make this.
    """
    try:
        content = zlib.decompressobj().decompress(base64.b64decode(text), MAX_BYTES)
    except zlib.error as problem:
        raise ValueError(str(problem)) from None
    steps = np.ascontiguousarray(np.frombuffer(content, np.uint8).reshape(4, -1).T).view("<u4")[:, 0]
    return np.asarray(np.cumsum(steps, dtype="<u4").view("<f4"), dtype=np.float64)
