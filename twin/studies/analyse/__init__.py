"""The loops of an experiment, linear: operating points, drives identified through their FMUs, stability."""
