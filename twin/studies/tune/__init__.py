"""Tuning of gains for given goals: search on the linear model of the sampled loops, check in the co-simulation."""
