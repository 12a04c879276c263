"""Linear analysis of an experiment's loops: operating points, drives identified through their FMUs, stability."""
