"""The processes that run experiments for pages: warm, watched, and replaced when one ends."""

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.process.guard import JobFailure, JobLoadFailure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import WarmProcess
from twin.report.explore import ANSWER_JOB

OUTDATED_TIMEOUT = 3.0
"""Maximum time (s) that an outdated answer keeps a process."""


class OutdatedAnswer(TwinError):
    """A newer state was requested, and this answer took too long to be waited for."""


class AnsweringProcess:
    """A warm process for the requests of pages.

    Args:
        limits: of the process.
    """

    def __init__(self, limits: JobLimits):
        self._process = WarmProcess(ANSWER_JOB, limits, self._raise_if_stale)
        self.close = self._process.close

    def answer(self, base: Mapping[str, Any], ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Return the answer of `twin.report.explore.worker.answer_request`.

        Args:
            base: fields of `Base`.
            ask: of the page.
            outdated: set when a newer answer is requested.

        Raises:
            ComponentFailed: a drive crashed, hung or ended the process: which one, where and when, in one sentence.
            Outdated: it was given up.
            TwinError: an internal error.
        """
        self._outdated, self._began = outdated, time.monotonic()
        try:
            found: dict[str, Any] = self._process.answer(
                {"here": str(Path.cwd()), "base": dict(base), "ask": dict(ask)}
            )
        except (JobFailure, JobLoadFailure) as ended:
            raise ComponentFailed(str(ended)) from None
        return found

    def _raise_if_stale(self) -> None:
        if self._outdated.is_set() and time.monotonic() - self._began > OUTDATED_TIMEOUT:
            raise OutdatedAnswer("given up for a newer state")
