"""The processes that run experiments for pages: warm, watched, and replaced when one ends."""

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.process.guard import JobEnded, JobEndedLoading, Watchdog, raise_failure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.process import GuardedProcess, process_for
from twin.report.explore import ANSWERED

POLL = 0.05
"""How often (s) limits are looked at while an answer is waited for."""
OUTDATED = 3.0
"""How long (s) an outdated answer may go on taking a process."""


class Outdated(TwinError):
    """A newer state was asked for, and this one took too long to be waited for."""


class AnsweringProcess:
    """One process; a fresh one takes the place of one that has ended.

    What ends it, a crash of a drive say, costs the answer that it was making and nothing else.
    """

    def __init__(self, limits: JobLimits):
        self._limits = limits
        self._process: GuardedProcess | None = None

    def close(self) -> None:
        """End the process."""
        if self._process:
            self._process.close()
        self._process = None

    @property
    def memory(self) -> int:
        """Resident memory (bytes); 0 if there is no process, or the system does not tell."""
        return self._process.memory if self._process else 0

    def answer(self, base: Mapping[str, Any], ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """What `twin.report.explore.worker.answered` answers.

        Args:
            outdated: set when a newer one is wanted.

        Raises:
            ComponentFailed: a drive crashed, hung or ended the process: which one, where and when, in one sentence.
            Outdated: it was given up.
            TwinError: a mistake of ours.
        """
        if self._process is None:
            self._process = process_for(ANSWERED)
            self._watch = Watchdog(self._process, self._limits)
        process = self._process
        process.start({"here": str(Path.cwd()), "base": dict(base), "ask": dict(ask)})
        began = time.monotonic()
        try:
            while True:
                for report in process.reports(POLL):
                    self._watch.account.take(report)
                    raise_failure(report)
                    if "finished" in report:
                        found: dict[str, Any] = report["finished"]
                        # a fresh process is better than one that grows for ever
                        if process.memory > 0.5 * self._limits.memory:
                            self.close()
                        return found
                self._watch.raise_if_over()
                if outdated.is_set() and time.monotonic() - began > OUTDATED:
                    raise Outdated("given up for a newer state")
        except (JobEnded, JobEndedLoading) as ended:
            self.close()
            raise ComponentFailed(str(ended)) from None
        except BaseException:
            self.close()
            raise
