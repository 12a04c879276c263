"""The explorer: an experiment in the browser that is run again while a slider moves."""

import re
from pathlib import Path

ANSWERED = "twin.report.explore.worker:answered"
"""The job of the processes that run experiments; here, for importing it means importing what runs them."""
FMU_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}\.fmu")
"""Of a drive that may be brought in."""
LOG_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}\.(csv|mcap|db3)(\.zstd)?")
"""Of a log that may be."""
EXPLORED_FOLDER = Path("results/explored")
"""Runs that were recorded from a page, NAME/TIME, so that none is the latest of results/NAME; and files brought in."""
