"""Experiments with [[measure]] tables against stored baselines: what was, what is, what is worse."""

from twin.studies.check.check import Deviation, check

__all__ = ["Deviation", "check"]
