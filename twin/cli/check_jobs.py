"""The checks of `twin check`, shared out among guarded processes."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

from twin.cli.progress import progress
from twin.errors import TwinError
from twin.runs.guard.guard import guarded
from twin.runs.guard.voice import DirectVoice
from twin.studies.check.job import Outcome, Pair, checked

JOB = "twin.studies.check.job:checked"


def finished(pairs: list[Pair], folder: Path, reason: str, processes: int) -> list[Outcome]:
    """The outcome of every pair, in their order.

    Args:
        folder: of the baselines. reason: of an update; "": nobody asked for one.
        processes: how many at a time; 0: this one, where a drive that crashes takes it along.

    Raises:
        KeyboardInterrupt: after every process has ended.
    """
    arguments = {"folder": str(folder), "date": date.today().isoformat(), "reason": reason}
    outcomes: dict[Pair, Outcome] = {}
    line = progress()

    def hear(note: dict[str, Any]) -> None:
        outcome = Outcome.of(note)
        outcomes[outcome.pair] = outcome
        line.say(f"{len(outcomes)} of {len(pairs)} checks")

    try:
        if processes == 0:
            voice = DirectVoice(hear, lambda done, total: None)
            checked(voice, work=[asdict(pair) for pair in pairs], **arguments)
        else:
            stop = threading.Event()
            with ThreadPoolExecutor(processes) as pool:
                # every n-th, because drives differ in speed far more than experiments do
                shares = [pairs[start::processes] for start in range(min(processes, len(pairs)))]
                running = [pool.submit(_share, share, arguments, hear, stop) for share in shares]
                try:
                    for share in running:
                        share.result()
                except BaseException:
                    stop.set()
                    raise
    finally:
        line.clear()
    return [outcomes[pair] for pair in pairs]


def _share(
    pairs: list[Pair], arguments: dict[str, str], hear: Callable[[dict[str, Any]], None], stop: threading.Event
) -> None:
    """Check `pairs` in a process of their own, and in another one what is left when a drive has ended the first."""
    left = list(pairs)

    def take(note: dict[str, Any]) -> None:
        del left[0]
        hear(note)

    def show(done: int, total: int) -> None:
        # Ctrl-C reaches the main thread alone
        if stop.is_set():
            raise KeyboardInterrupt

    while left and not stop.is_set():
        try:
            guarded(JOB, {"work": [asdict(pair) for pair in left], **arguments}, listen=take, show=show)
        except TwinError as death:
            if not left:
                raise
            take(asdict(Outcome(left[0], None, failure=str(death), exit_code=death.exit_code)))
