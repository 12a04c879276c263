"""Many runs of one experiment: a design of parameters and drives, warm worker processes, one row per run."""

SERVED = "twin.studies.sweep.worker:served"
"""The job of a worker process; here, for importing it means importing what runs need."""
