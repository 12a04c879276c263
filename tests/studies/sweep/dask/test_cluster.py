"""Waiting for a cluster, which has an end."""

import os
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.studies.sweep.definitions import job, stiffnesses
from twin.studies.sweep.dask import engine as engine_module
from twin.studies.sweep.dask.cluster import attempt_with_timeout, call_with_timeout, difference
from twin.studies.sweep.dask.engine import _Batches
from twin.studies.sweep.interrupts import defer_interrupts

FOREVER = 600.0
"""s; longer than any test may take."""


def test_what_is_asked_of_a_cluster_is_answered_or_fails_as_it_does_there():
    assert call_with_timeout(FOREVER, divmod, 7, 2) == (3, 1)
    with pytest.raises(ZeroDivisionError):
        call_with_timeout(FOREVER, divmod, 7, 0)


def test_nobody_waits_longer_than_the_limit():
    never = threading.Event()
    try:
        with pytest.raises(TimeoutError, match=r"no answer within 0\.1 s"):
            call_with_timeout(0.1, never.wait, FOREVER)
        attempt_with_timeout(0.1, never.wait, FOREVER)
    finally:
        never.set()


def test_a_cluster_that_does_not_answer_holds_up_no_end(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked, never = [], threading.Event()

    def silent(name: str) -> None:
        asked.append(name)
        never.wait(FOREVER)

    client = SimpleNamespace(
        status="running",
        scheduler=SimpleNamespace(address="tcp://nowhere"),
        loop=object(),
        cancel=lambda *told, **how: silent("cancel"),
        unregister_worker_plugin=lambda *told, **how: silent("unregister"),
    )
    plan = stiffnesses(root, tmp_path, "[500]")
    monkeypatch.setattr(engine_module, "END_TIMEOUT", 0.1)
    try:
        _Batches(client, job(plan, tmp_path), plan.tasks).stop()  # type: ignore[arg-type]
    finally:
        never.set()
    assert asked == ["cancel", "unregister"]


def test_ctrl_c_leaves_no_lock_taken_by_what_was_asked():
    lock, asked = threading.Lock(), threading.Event()

    def answer() -> None:
        with lock:
            asked.set()
            time.sleep(0.3)

    def press() -> None:
        asked.wait()
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press)
    presser.start()
    with pytest.raises(KeyboardInterrupt), defer_interrupts():
        call_with_timeout(FOREVER, answer)
    presser.join()
    assert lock.acquire(timeout=FOREVER)


def test_versions_that_differ_are_named_and_equal_ones_are_not():
    ours = {"numba": "0.61.0", "Python": "3.11"}
    assert difference("worker a", ours, ours) == ""
    told = difference("worker a", {"Python": "3.11"}, ours)
    assert told == "worker a has numba none, this machine has 0.61.0"
