"""The job of a worker process: runs one after the other for as long as orders come."""

import contextlib
import gc
import json
import shutil
from pathlib import Path

from twin.runs.guard.job import function_called
from twin.runs.guard.reporter import Reporter
from twin.studies.sweep.trial import record


def served(reporter: Reporter, experiment: str, orders: str, folder: str, claims: str, trial: str) -> None:
    """Run every order; what is imported, compiled or unpacked for one is there for the next.

    Notes: {"finding": facts of `Finding`} after each.

    Args:
        experiment: its file.
        folder: where recordings go, a folder per run.
        claims: see `twin.studies.sweep.trial.trial`.
        trial: see `Job`.
        orders: a named pipe, alone in its folder, that brings {"run", "drive", "settings", "record"} as JSON lines;
            ends the job when it is closed. What is to be recorded is run twice: so measuring never depends on the
            recorder, and a good run in a sweep that records failures never meets it.

    Raises:
        RecordingFailed: the disk is full.
    """
    judged = function_called(trial)
    with open(orders, encoding="utf-8") as lines:
        # it is open at both ends now; who made it may be killed
        with contextlib.suppress(OSError):
            Path(orders).unlink()
            Path(orders).parent.rmdir()
        for number, line in enumerate(lines):
            order = json.loads(line)
            what = Path(experiment), order["drive"], order["settings"]
            own = Path(folder) / f"{order['run']:06d}"
            reporter.loading()
            if order["record"] != "none":
                # what an earlier attempt left of the same run
                shutil.rmtree(own, ignore_errors=True)
            if order["record"] == "all":
                record(*what, own)
                reporter.loading()
            finding = judged(*what, claims)
            if order["record"] == "failures" and finding.status != "done":
                reporter.loading()
                record(*what, own)
            reporter.note(finding=finding.facts)
            if number == 0:
                # what one run has loaded stays for all others: it need not be looked through for garbage again
                gc.collect()
                gc.freeze()
