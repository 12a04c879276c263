"""The explorer: an experiment in the browser that is run again while a slider moves."""

ANSWERED = "twin.report.explore.worker:answered"
"""The job of the processes that run experiments; here, for importing it means importing what runs them."""
