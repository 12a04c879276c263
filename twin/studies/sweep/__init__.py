"""Many runs of one experiment: a design of parameters and drives, warm worker processes, one row per run."""
