"""Processes that run experiments for pages: warm, guarded, and replaced when one ends."""

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
"""Maximum time (s) that an outdated request occupies a process."""


class OutdatedAnswer(TwinError):
    """Exception that cancels an answer: a newer state was requested, and it exceeded `OUTDATED_TIMEOUT`."""


class AnsweringProcess:
    """A process kept running to answer requests of explorer pages."""

    def __init__(self, limits: JobLimits):
        self._process = WarmProcess(ANSWER_JOB, limits, self._raise_if_stale)
        self.close = self._process.close

    def answer(self, base: Mapping[str, Any], ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Answer the request `ask` of a page of `PageBase` by `twin.report.explore.worker.answer_request`.

        `outdated` is set when a newer answer is requested. ComponentFailed: a drive crashed, hung or ended the process;
        names the drive, place and time in one sentence. OutdatedAnswer: the answer was cancelled. TwinError: an
        internal error.
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
