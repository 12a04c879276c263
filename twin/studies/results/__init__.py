"""Stored runs: time, experiment, differences from its current file, and removal of old runs."""
