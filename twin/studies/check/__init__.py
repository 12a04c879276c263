"""Experiments with [[measure]] tables against stored baselines: what was, what is, what is worse."""
