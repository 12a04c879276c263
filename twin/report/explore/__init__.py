"""The explorer: an experiment in the browser that is run again while a slider moves."""

from pathlib import Path

ANSWER_JOB = "twin.report.explore.worker:answer_request"
"""The job of the processes that run experiments; here, for importing it means importing what runs them."""
EXPLORED_FOLDER = Path("results/explored")
"""Folder of runs recorded from a page, NAME/TIME, so that none is the latest of results/NAME."""
