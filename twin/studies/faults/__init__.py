"""Fault matrix: an experiment run once per kind, magnitude and onset of a fault, with its monitor and without."""
