"""Checks shared out among guarded processes."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import date
from typing import Any

from twin.errors import TwinError
from twin.runs.guard.guard import guarded
from twin.runs.guard.reporter import DirectReporter
from twin.studies.check.job import CheckOutcome, Pair, checked
from twin.studies.steps import Say

JOB = "twin.studies.check.job:checked"


def outcomes(pairs: Sequence[Pair], reason: str, processes: int, say: Say) -> list[CheckOutcome]:
    """The outcome of every pair, in their order.

    Args:
        pairs: what to check.
        reason: of an update; "": nobody asked for one.
        processes: how many at a time; 0: this one, where a drive that crashes takes it along.
        say: told how many are done.

    Raises:
        KeyboardInterrupt: after every process has ended.
    """
    arguments: dict[str, Any] = {"date": date.today().isoformat(), "reason": reason}
    found: dict[Pair, CheckOutcome] = {}

    say(f"0 of {len(pairs)} checks", 0.0)

    def hear(note: dict[str, Any]) -> None:
        outcome = CheckOutcome.of(note)
        found[outcome.pair] = outcome
        say(f"{len(found)} of {len(pairs)} checks", len(found) / len(pairs))

    if processes == 0:
        checked(DirectReporter(hear), pairs, **arguments)
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
    return [found[pair] for pair in pairs]


def _share(
    pairs: Sequence[Pair], arguments: dict[str, Any], hear: Callable[[dict[str, Any]], None], stop: threading.Event
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
            guarded(JOB, {"work": left, **arguments}, listen=take, show=show)
        except TwinError as failure:
            if not left:
                raise
            take(asdict(CheckOutcome(left[0], None, failure=str(failure), exit_code=failure.exit_code)))
