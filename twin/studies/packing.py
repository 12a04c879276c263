"""Compact text for samples: 32 bit floats, deflated (RFC 1950), in base 64.

The bit patterns, read as integers, are replaced by differences of neighbours, and the bytes of the same weight are
grouped: neighbours differ in their low bits only, so the text has a third of the size of the floats alone. Only the
rounding to 32 bits is lost. The scripts of a page decode the same format.
"""

import base64
import zlib

import numpy as np

from twin.studies.metrics.response import Curve

MAX_BYTES = 4_000_000
"""Maximum unpacked size (bytes): a million samples, eleven hours of a curve in a sweep."""
COMPRESSION_LEVEL = 6
"""Level of zlib: higher levels double the time for one percent."""


def text_of(values: Curve) -> str:
    """Encode numbers (n,) as compact text with 32 bit accuracy; equal values give equal text."""
    steps = np.diff(values.astype("<f4").view("<u4"), prepend=np.uint32(0))
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, 4).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), COMPRESSION_LEVEL)).decode("ascii")


def values_of(text: str) -> Curve:
    """Decode the numbers (n,) in a compact text; raise ValueError if `text_of` did not make the text."""
    try:
        content = zlib.decompressobj().decompress(base64.b64decode(text), MAX_BYTES)
    except zlib.error as problem:
        raise ValueError(str(problem)) from None
    steps = np.ascontiguousarray(np.frombuffer(content, np.uint8).reshape(4, -1).T).view("<u4")[:, 0]
    return np.asarray(np.cumsum(steps, dtype="<u4").view("<f4"), dtype=np.float64)
