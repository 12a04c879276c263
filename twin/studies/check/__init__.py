"""Regression checks of experiments with [[measure]] tables against stored baselines."""
