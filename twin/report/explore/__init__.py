"""The explorer: an experiment in the browser that is run again while a slider moves."""

from pathlib import Path

ANSWER_JOB = "twin.report.explore.worker:answer_request"
"""Job of the processes that run experiments; defined here because importing its module loads all that runs need."""
EXPLORED_FOLDER = Path("results/explored")
"""Folder of runs recorded from a page, NAME/TIME, so that `results/NAME/latest` never points to one of them."""
