"""A batch in which the machine of the worker fails, whoever tries: for workers of another process."""

import os
from collections.abc import Sequence

from twin.studies.sweep.dask import workplace
from twin.studies.sweep.dask.parcel import Order
from twin.studies.sweep.dask.workplace import Errand, Reply

DEADLY = 3
"""The number of the run that no machine survives."""


def ran(errand: Errand, orders: Sequence[Order]) -> Reply:
    """As `workplace.ran`, but for the worst."""
    if any(run == DEADLY for run, _, _ in orders):
        os._exit(1)
    return workplace.ran(errand, orders)
