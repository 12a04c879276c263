"""The job of a worker process: runs one after the other for as long as orders come."""

import json
import shutil
from pathlib import Path

from twin.guard.voice import Voice
from twin.sweep.trial import trial


def served(voice: Voice, experiment: str, orders: str, folder: str, record: str, claims: str) -> None:
    """Run every order; what is imported, compiled or unpacked for one is there for the next, FMU instances are not.

    Notes: {"finding": facts of `Finding`} after each.

    Args:
        experiment: its file. orders: a named pipe that brings {"run", "drive", "settings"} as JSON lines; ends the job
            when it is closed.
        folder: where recordings go, a folder per run. record: "all", "failures" or "none". claims: see `trial`.

    Raises:
        RecordingFailed: the disk is full.
    """
    with open(orders, encoding="utf-8") as lines:
        for line in lines:
            order = json.loads(line)
            voice.loading()
            own = Path(folder) / f"{order['run']:06d}" if record != "none" else None
            if own:
                # what an earlier worker left of the same run
                shutil.rmtree(own, ignore_errors=True)
            finding = trial(Path(experiment), order["drive"], order["settings"], own, claims)
            if own and record == "failures" and finding.status == "done":
                shutil.rmtree(own)
            voice.note(finding=finding.facts)
