"""Many runs of one experiment: a design of parameters and drives, warm worker processes, one row per run."""

WORKER_JOB = "twin.studies.sweep.worker:run_task"
"""The job of a worker process; here, for importing it means importing what runs need."""
