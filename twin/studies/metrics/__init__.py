"""Metrics of recorded signals, as numbers computed from arrays."""
