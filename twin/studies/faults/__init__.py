"""Fault matrix: an experiment run once per kind, magnitude and onset of a fault, with its monitor and without."""

from enum import StrEnum


class SetOfFaults(StrEnum):
    """Number of simultaneous faults: one, a common cause, or a pair; here because `--help` imports it."""

    SINGLE = "single"
    COMMON = "common"
    PAIRS = "pairs"
