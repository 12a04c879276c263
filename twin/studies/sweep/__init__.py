"""Many runs of one experiment: a design of parameters and drives, warm worker processes, one row per run."""

WORKER_JOB = "twin.studies.sweep.worker:run_task"
"""Job of a worker process; defined here because importing the worker module imports everything a run needs."""
