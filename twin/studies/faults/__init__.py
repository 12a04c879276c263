"""The matrix of faults: an experiment run once per kind, magnitude and onset, with its safety monitor and without."""
