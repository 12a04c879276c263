"""Warm processes and their pool: one answer after the other, and what ends a process costs one of them."""

import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

import pytest

from twin.kernel.errors import TwinError
from twin.kernel.process.guard import JobLoadFailure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import Pool, WarmProcess, _batch

WARM = "tests.kernel.process.jobs:warm"
LIMITS = JobLimits(step=2.0)


class Enough(Exception):
    """Nobody waits any more."""


def ends(pid: int) -> bool:
    """Whether a process ends soon."""
    for _ in range(600):
        if not Path(f"/proc/{pid}").exists():
            return True
        time.sleep(0.05)
    return False


def test_a_process_answers_again_and_again_and_ends_with_its_block():
    with WarmProcess(WARM, LIMITS) as process:
        assert process.fresh and process.memory == 0
        first, second = process.answer({}), process.answer({})
        assert first["pid"] == second["pid"] and (first["count"], second["count"]) == (1, 2)
        assert not process.fresh and process.memory > 0
    assert process.fresh and ends(first["pid"])


def test_a_process_that_dies_costs_one_answer_and_the_next_one_is_fresh():
    with WarmProcess(WARM, LIMITS) as process:
        before = process.answer({})
        with pytest.raises(JobLoadFailure, match=r"ended the process with exit\(3\)"):
            process.answer({"leave": 3})
        assert process.fresh
        after = process.answer({})
    assert after["count"] == 1 and after["pid"] != before["pid"]


def test_an_error_of_the_job_is_raised_and_its_process_replaced():
    with WarmProcess(WARM, LIMITS) as process:
        with pytest.raises(TwinError, match="a teapot"):
            process.answer({"refuse": "a teapot"})
        assert process.fresh and process.answer({})["count"] == 1


def test_a_process_that_has_grown_is_replaced_after_its_answer():
    with WarmProcess(WARM, JobLimits(memory=2.0)) as process:
        # so small that every process has grown; the limit itself is not looked at when an answer is there
        with suppress(TwinError):
            process.answer({})
        assert process.fresh


def test_an_answer_that_nobody_waits_for_is_given_up_with_its_process():
    begun = threading.Event()

    def check() -> None:
        if begun.is_set():
            raise Enough

    with WarmProcess(WARM, LIMITS, check) as process:
        pid = process.answer({})["pid"]
        begun.set()
        with pytest.raises(Enough):
            process.answer({"sleep": 1000.0})
        assert process.fresh and ends(pid)


def ask(process: WarmProcess, task: dict) -> dict:
    return process.answer(task)


def test_a_pool_answers_every_task_once_in_as_many_processes_and_may_be_asked_again():
    with Pool(2, WARM, LIMITS, ask) as pool:
        tasks = [{"echo": number} for number in range(20)]
        found = [pair for batch in pool.answers(tasks) for pair in batch]
        assert sorted(answer["echo"] for _, answer in found) == list(range(20))
        assert all(task["echo"] == answer["echo"] for task, answer in found)
        pids = {answer["pid"] for _, answer in found}
        assert len(pids) <= 2
        ((_, more),) = [pair for batch in pool.answers([{}]) for pair in batch]
        assert more["count"] > 1
        pids.add(more["pid"])
    assert all(map(ends, pids))


def test_waiting_for_a_pool_comes_back_with_nothing_so_that_others_are_heard():
    with Pool(1, WARM, LIMITS, ask) as pool:
        answers = pool.answers([{"sleep": 1000.0}])
        assert next(answers) == []


def test_answers_that_were_there_before_a_failure_come_before_it():
    with Pool(1, WARM, LIMITS, ask) as pool:
        answers = pool.answers([{"echo": 1}, {"refuse": "a teapot"}, {"echo": 2}])
        found = []
        with pytest.raises(TwinError, match="a teapot"):
            for batch in answers:
                found += batch
        assert [answer["echo"] for _, answer in found] == [1]


def test_a_failure_waits_behind_the_answers_that_came_with_it():
    done: SimpleQueue[object] = SimpleQueue()
    done.put("an answer")
    done.put(TwinError("a teapot"))
    assert _batch(done) == ["an answer"]
    with pytest.raises(TwinError, match="a teapot"):
        _batch(done)


def test_a_process_that_is_interrupted_from_outside_ends_the_wait():
    with Pool(1, WARM, LIMITS, ask) as pool, pytest.raises(KeyboardInterrupt):
        for _ in pool.answers([{"interrupt": True}]):
            pass
