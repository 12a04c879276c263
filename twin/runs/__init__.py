"""One run: an experiment assembled, stepped in slices, watched and recorded as it goes."""

from twin.runs.run import SLICE_TICKS, SUMMARY, Run, execute

__all__ = ["SLICE_TICKS", "SUMMARY", "Run", "execute"]
