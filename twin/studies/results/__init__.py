"""Stored runs: when, which experiment, differences from its file as it is now, and what may be removed."""
