"""Whether a finished recording reaches as far as it says that its run was to go, without a hole.

Chunks can be taken out of a file and the rest be sealed again, index and all. What then still tells is that a run is
recorded tick by tick, from 0 to the duration of its experiment.
"""

from collections.abc import Mapping

import numpy as np

from twin.errors import InputRefused
from twin.files import json_of
from twin.recording.recording import Stream
from twin.recording.series import NANOSECONDS

ROUNDING = 2
"""ns; times are rounded to whole ones."""


def shortfall(streams: Mapping[str, Stream], metadata: Mapping[str, Mapping[str, str]]) -> str:
    """One sentence on what is missing; "" if nothing is, or if the recording does not say how long it was to be."""
    duration = _duration(metadata)
    times = {topic: stream.head["log_time"].astype(np.int64) for topic, stream in streams.items()}
    if duration is None or not any(len(t) for t in times.values()):
        return ""
    end = max(int(t[-1]) for t in times.values() if len(t))
    for topic, t in times.items():
        if not len(t) or t[0] > ROUNDING:
            return f"the first samples of {topic} are missing"
        steps = np.diff(t)
        # every step is the topic's period; the last sample is less than one before the end
        period = int(np.median(steps)) if len(steps) else 0
        uneven = np.flatnonzero(np.abs(steps - period) > ROUNDING)
        if len(uneven):
            at = uneven[0]
            return (
                f"samples of {topic} are missing or moved: after {t[at] / NANOSECONDS:.3f} s comes "
                f"{t[at + 1] / NANOSECONDS:.3f} s, though one is due every {period / NANOSECONDS:g} s"
            )
        if len(steps) and end - t[-1] >= period - ROUNDING:
            return f"samples of {topic} are missing: the last is at {t[-1] / NANOSECONDS:.3f} s"
    # a duration is a whole number of ticks to a billionth
    if abs(end - duration * NANOSECONDS) > ROUNDING + duration:
        return f"ends at {end / NANOSECONDS:.3f} s, though its experiment lasts {duration:g} s"
    return ""


def _duration(metadata: Mapping[str, Mapping[str, str]]) -> float | None:
    """Of the run (s), as its experiment says; None: it does not."""
    try:
        values = json_of(metadata["experiment"]["values"], "")
        duration = float(values["duration_s"])
    except (InputRefused, KeyError, TypeError, ValueError, OverflowError):
        return None
    return duration if 0.0 < duration < 1e9 else None
