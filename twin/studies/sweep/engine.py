"""Whoever runs the runs of a sweep. Rows, resuming, progress and Ctrl-C are the same for all of them."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from twin.runs.guard.limits import Limits
from twin.studies.sweep.plan import Task

Result = tuple[Task, dict[str, Any]]
"""A run and the facts of its `Finding`."""


@dataclass(frozen=True)
class Job:
    """What all runs of a sweep have in common.

    Attributes:
        experiment: its file.
        recordings: the folder in which a run's recording gets a folder of its own.
        record: of which runs, "all", "failures" or "none".
        claims: "fig4" or "", see `Definition`.
        limits: of each worker process.
        trial: who runs a run and says what it comes to, "module:function"; called like the default.
    """

    experiment: Path
    recordings: Path
    record: str
    limits: Limits
    claims: str
    trial: str = "twin.studies.sweep.trial:trial"

    @property
    def arguments(self) -> dict[str, str]:
        """Of `twin.studies.sweep.worker.served`, but for the orders; absolute, because an FMU may change the folder."""
        return {
            "experiment": str(self.experiment.absolute()),
            "folder": str(self.recordings.absolute()),
            "claims": self.claims,
            "trial": self.trial,
        }


class Engine(Protocol):
    """Runs runs somewhere. It may be used again when one sweep is over."""

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """Every one of `tasks` exactly once, in any order, in batches as they come.

        A run that fails, crashes or hangs is a result like any other; what comes out of a run must not depend on where,
        in which order or after which others it is run. Closing the iterator ends everything that it began; runs that
        are under way then are lost. Whoever waits here asks `raise_if_pressed` at least every `HEAR` seconds.

        Raises:
            TwinError: no run can go on, say because the disk is full or the cluster is gone.
            KeyboardInterrupt: Ctrl-C.
        """
