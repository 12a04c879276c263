"""Gains for given goals: searched on the linear model of the sampled loops, tried in the co-simulation."""
