"""Rows, resuming and limits are the same whoever runs the runs: here an engine that only pretends to.

What drives do to their process costs the run that does it; where and when a run is made is not seen in its row.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.kernel.process.conftest import drive as drive  # the hostile drive
from tests.kernel.process.hostile import EXIT, HANG, HANG_IN_INITIALISATION, LEAK, SEGFAULT, SEGFAULT_IN_FREE
from tests.kernel.recording.test_writer import largest_file
from tests.studies.sweep.definitions import STIFFNESS, job, stiffnesses, written
from twin.kernel.errors import InputRefused, TwinError
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import WarmProcess
from twin.studies.sweep import WORKER_JOB
from twin.studies.sweep.engine import Job, LocalEngine, Result, run_facts
from twin.studies.sweep.interrupts import MAX_PRESSES, defer_interrupts, raise_interrupt
from twin.studies.sweep.measures import run_fields
from twin.studies.sweep.plan import SweepPlan, Task, read_plan
from twin.studies.sweep.rows import ROWS_FILE, DiskError, read_rows
from twin.studies.sweep.stored import SWEEP_FILE, stored_sweep
from twin.studies.sweep.sweep import SweepState, run_sweep

RUNS = 12
VALUES = str([500 + 10 * number for number in range(RUNS)])


class Pretender:
    """Gives runs back in any order and batches, every fifth of them failed, until it is interrupted.

    Attributes:
        asked: tasks that it was given. closed: whether it was let go.
    """

    def __init__(self, order: Sequence[int] = range(RUNS), batch: int = 1, until: int = RUNS):
        self._order, self._batch, self._until = order, batch, until
        self.asked: list[Task] = []
        self.closed = False

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        self.asked = list(tasks)
        ordered = [task for number in self._order for task in tasks if task.run == number + 1]
        try:
            for first in range(0, len(ordered), self._batch):
                if first >= self._until:
                    raise KeyboardInterrupt
                yield [(task, facts(task)) for task in ordered[first : first + self._batch]]
        finally:
            self.closed = True


def facts(task: Task) -> dict:
    if task.run % 5 == 0:
        return run_fields("failed", "because", {}, float("nan"), float("nan"))
    stiffness = float(task.parameters[STIFFNESS])
    return run_fields("done", "", {"force_error_N": stiffness, "peak_N": 1.0 / stiffness}, 0.1, 0.05)


@pytest.fixture(scope="module")
def plan(root: Path, tmp_path_factory: pytest.TempPathFactory) -> SweepPlan:
    more = "[limits]\nforce_error_N = 550\n"
    return stiffnesses(root, tmp_path_factory.mktemp("plan"), VALUES, more)


@pytest.fixture(scope="module")
def undisturbed(plan: SweepPlan, tmp_path_factory: pytest.TempPathFactory) -> list[dict]:
    folder = tmp_path_factory.mktemp("undisturbed")
    run_sweep(plan, folder, Pretender())
    return stored_sweep(folder).rows


@pytest.mark.slow
@examples(25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.permutations(range(RUNS)), st.integers(1, RUNS), st.lists(st.integers(0, RUNS), max_size=3))
def test_rows_do_not_depend_on_order_batches_and_interruptions(
    plan: SweepPlan,
    undisturbed: list[dict],
    tmp_path_factory: pytest.TempPathFactory,
    order,
    batch: int,
    cuts: list[int],
):
    folder = tmp_path_factory.mktemp("disturbed")
    for cut in cuts:
        engine = Pretender(order, batch, cut)
        try:
            run_sweep(plan, folder, engine)
        except KeyboardInterrupt:
            assert engine.closed
    rows_before = len(read_rows(folder / ROWS_FILE))
    last = Pretender(order, batch)
    run_sweep(plan, folder, last)
    assert len(last.asked) == RUNS - rows_before
    assert stored_sweep(folder).rows == undisturbed
    assert (folder / ROWS_FILE).read_bytes().count(b"\n") == RUNS


def test_a_finished_sweep_runs_nothing_again(plan: SweepPlan, tmp_path: Path):
    run_sweep(plan, tmp_path, Pretender())
    again = Pretender()
    run_sweep(plan, tmp_path, again)
    assert len(stored_sweep(tmp_path).columns) == RUNS
    assert again.asked == []


def test_an_interruption_by_whoever_is_shown_the_state_lets_the_engine_go(plan: SweepPlan, tmp_path: Path):
    def show(state: SweepState) -> None:
        if state.done == 3:
            raise KeyboardInterrupt

    engine = Pretender()
    with pytest.raises(KeyboardInterrupt):
        run_sweep(plan, tmp_path, engine, show=show)
    assert engine.closed
    assert [row["run"] for row in stored_sweep(tmp_path).rows] == [1, 2, 3]


@pytest.mark.slow
def test_a_full_disk_loses_nothing_finished(plan: SweepPlan, undisturbed: list[dict], tmp_path: Path):
    engine = Pretender()
    run_sweep(plan, tmp_path / "all", Pretender())
    rows, described = ((tmp_path / "all" / name).stat().st_size for name in (ROWS_FILE, SWEEP_FILE))
    with largest_file(max(rows // 2, described)), pytest.raises(DiskError, match=r"No space|File too large"):
        run_sweep(plan, tmp_path / "full", engine)
    assert engine.closed
    finished = stored_sweep(tmp_path / "full").rows
    assert 0 < len(finished) < RUNS and finished == undisturbed[: len(finished)]
    run_sweep(plan, tmp_path / "full", Pretender())
    assert stored_sweep(tmp_path / "full").rows == undisturbed


@pytest.mark.parametrize("what", ["the sweep", "the experiment, a body or an FMU", "the version of twin"])
def test_rows_of_another_configuration_are_never_added_to(plan: SweepPlan, tmp_path: Path, what: str):
    run_sweep(plan, tmp_path, Pretender())
    changed = replace(plan, configuration={**plan.configuration, what: "other"})
    engine = Pretender()
    with pytest.raises(InputRefused, match=f"since then {what} changed; .* choose another --out"):
        run_sweep(changed, tmp_path, engine)
    assert engine.asked == []
    assert len(stored_sweep(tmp_path).rows) == RUNS


def test_a_changed_sweep_file_is_a_changed_configuration(root: Path, plan: SweepPlan, tmp_path: Path):
    other = stiffnesses(root, tmp_path, "[500, 510]")
    run_sweep(other, tmp_path / "s", Pretender())
    with pytest.raises(InputRefused, match="since then the sweep changed"):
        run_sweep(plan, tmp_path / "s", Pretender())


def test_limits_are_a_verdict_and_a_failed_run_keeps_none(undisturbed: list[dict]):
    for row in undisturbed:
        value = row["metrics"].get("force_error_N")
        assert row["within_limits"] is (value is not None and value <= 550)


def test_the_state_counts_runs_failures_and_the_best_so_far(plan: SweepPlan, tmp_path: Path):
    states: list[SweepState] = []
    with pytest.raises(KeyboardInterrupt):
        run_sweep(plan, tmp_path, Pretender(until=6), show=states.append)
    assert (states[0].done, states[-1].done, states[-1].failed) == (0, 6, 1)
    states.clear()
    run_sweep(plan, tmp_path, Pretender(), show=states.append)
    assert (states[0].done, states[0].rate, states[0].remaining) == (6, 0.0, None)
    assert (states[-1].done, states[-1].total, states[-1].failed) == (RUNS, RUNS, 2)
    assert states[-1].best == ("force_error_N", 500.0, 1)
    assert states[-1].remaining == 0.0


def test_of_runs_that_are_equally_good_the_first_is_the_best_whatever_came_first(
    plan: SweepPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    equal = run_fields("done", "", {"force_error_N": 1.0}, 0.1, 0.05)
    monkeypatch.setitem(globals(), "facts", lambda task: equal)
    states: list[SweepState] = []
    run_sweep(plan, tmp_path, Pretender(range(RUNS)[::-1], 5), show=states.append)
    assert [state.best and state.best[2] for state in states] == [None, 8, 3, 1]


class Gone:
    """What is pressed while this is cleared away is lost."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_sweep_ends_though_ctrl_c_was_swallowed(root: Path, tmp_path: Path):
    def show(state: SweepState) -> None:
        if state.done:
            # swallowed here, in the middle of a sweep
            Gone()

    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_sweep(stiffnesses(root, tmp_path, str([*range(500, 2500)])), folder, LocalEngine(1), show=show)
    assert 0 < len(stored_sweep(folder).rows) < 2000


def test_ctrl_c_is_what_it_was_before_afterwards():
    with defer_interrupts():
        raise_interrupt()
        # nothing happens where it falls
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_interrupt()
        # the end of the sweep is not disturbed
        os.kill(os.getpid(), signal.SIGINT)
        raise_interrupt()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_was_pressed_last_of_all_is_not_lost():
    with pytest.raises(KeyboardInterrupt), defer_interrupts():
        os.kill(os.getpid(), signal.SIGINT)
    raise_interrupt()


PRESSED_TWICE = """
import os, signal, sys
from twin.studies.sweep.interrupts import defer_interrupts

def press():
    os.kill(os.getpid(), signal.SIGINT)

def pressed_twice(moment):
    def trace(frame, event, argument):
        global lines
        if event == "line":
            lines += 1
            if lines == moment:
                press()
        return trace
    sys.settrace(trace)
    press()

# the second time at each line of what the first calls, and more
for moment in range(1, 60):
    lines = 0
    try:
        with defer_interrupts():
            pressed_twice(moment)
    except KeyboardInterrupt:
        if lines >= moment:
            print(moment)
    finally:
        sys.settrace(None)
"""
PRESSED_AGAIN = """
import os, signal
from twin.studies.sweep.interrupts import defer_interrupts

with defer_interrupts():
    for number in range({times}):
        os.kill(os.getpid(), signal.SIGINT)
    print("goes on", flush=True)
"""


def _said(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_two_at_any_two_moments_do_not_wait_for_each_other():
    said = _said(PRESSED_TWICE)
    assert said.returncode == 0, said.stderr
    moments = [int(line) for line in said.stdout.split()]
    assert 10 < len(moments) < 59 and moments == [*range(1, len(moments) + 1)]


def test_the_third_ends_the_process_whatever_it_is_doing():
    patient, over = (_said(PRESSED_AGAIN.format(times=times)) for times in (MAX_PRESSES - 1, MAX_PRESSES))
    # before the end nobody has asked whether it was pressed
    assert patient.stdout == "goes on\n" and "KeyboardInterrupt" in patient.stderr
    assert (over.returncode, over.stdout) == (130, "")
    assert over.stderr == "\ninterrupted; finished runs are kept\n"


def test_an_answer_of_somebody_else_is_left_alone():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with defer_interrupts():
            os.kill(os.getpid(), signal.SIGINT)
            raise_interrupt()
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_has_no_ctrl_c_to_remember():
    def work() -> None:
        with defer_interrupts():
            raise_interrupt()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


COST = ("seconds", "stepping_s")
LIMITS = JobLimits(step=2.0)


def results(
    plan: SweepPlan, tasks: list[Task], folder: Path, processes: int, record: str = "none", limits: JobLimits = LIMITS
):
    """Facts by run, without the cost."""
    found: dict[int, dict] = {}
    for batch in LocalEngine(processes).results(job(plan, folder, record, limits), tasks):
        for task, facts in batch:
            assert task.run not in found
            found[task.run] = {key: value for key, value in facts.items() if key not in COST}
    return found


@pytest.fixture
def hostile(root: Path, tmp_path: Path, drive: Path) -> Callable[[int, dict[int, int]], tuple[SweepPlan, list[Task]]]:
    """A plan of so many runs of which some, by number, are attacked by joint 2's drive after one second."""

    def made(count: int, attacks: dict[int, int]) -> tuple[SweepPlan, list[Task]]:
        text = f'extends = "{root}/experiments/fig4_position.toml"\nduration_s = 1.01\n'
        written(tmp_path, f"{text}[drive.joint_2]\nfmu = '{drive}'\nparameters.droop = 0\n", "e.toml")
        values = [500 + number for number in range(count)]
        plan = read_plan(
            written(
                tmp_path, f'experiment = "e.toml"\nvary = [{{ key = "contact.stiffness_N_per_m", values = {values} }}]'
            )
        )
        droop = "drive.joint_2.parameters.droop"
        tasks = [replace(t, settings=(*t.settings, f"{droop}={attacks.get(t.run, 0)}")) for t in plan.tasks]
        return plan, tasks

    return made


@pytest.mark.slow
def test_a_drive_that_crashes_in_every_tenth_run_costs_those_runs_only(hostile, tmp_path: Path):
    tenth = {run: SEGFAULT for run in (10, 20)}
    plan, tasks = hostile(20, tenth)
    found = results(plan, tasks, tmp_path, 2)
    assert [run for run, facts in sorted(found.items()) if facts["status"] != "done"] == [10, 20]
    for run in tenth:
        assert found[run]["metrics"] == {}
        assert found[run]["reason"].startswith(
            "hostile.fmu (drive_2) crashed (SIGSEGV, segmentation fault) in the step "
        )
    # those that came after a crash, and one before
    _, honest = hostile(20, {})
    assert results(plan, [honest[run - 1] for run in (1, 11, 12)], tmp_path, 1) == {
        run: found[run] for run in (1, 11, 12)
    }


@pytest.mark.slow
def test_other_deaths_are_rows_with_a_reason_too(hostile, tmp_path: Path):
    attacks = {1: EXIT, 2: HANG, 4: HANG_IN_INITIALISATION, 5: SEGFAULT_IN_FREE}
    plan, tasks = hostile(5, attacks)
    found = results(plan, tasks, tmp_path, 2, limits=JobLimits(step=0.7))
    assert {run: facts["status"] for run, facts in found.items()} == {
        run: "done" if run == 3 else "failed" for run in found
    }
    assert "ended the process with exit(0)" in found[1]["reason"]
    assert "did not return within 0.7 s" in found[2]["reason"]
    assert "did not return within 0.7 s" in found[4]["reason"]
    assert "crashed (SIGSEGV" in found[5]["reason"] and "FreeInstance" in found[5]["reason"]


def test_a_drive_that_grows_without_end_is_ended_at_the_limit_of_memory(hostile, tmp_path: Path):
    plan, tasks = hostile(2, {1: LEAK})
    tasks[0] = replace(tasks[0], settings=(*tasks[0].settings, "duration_s=20"))
    found = results(plan, tasks, tmp_path, 1, limits=JobLimits(memory=5e8))
    assert "grew to" in found[1]["reason"] or "memory" in found[1]["reason"]
    assert found[2]["status"] == "done"


@pytest.mark.slow
def test_rows_are_the_same_in_any_order_in_any_number_of_processes(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500, 700, 900, 1100]", 'drives = ["velocity_servo", "stepper"]')
    tasks = [replace(task, settings=(*task.settings, "duration_s=8")) for task in plan.tasks]
    one = results(plan, tasks, tmp_path, 1)
    assert all(facts["status"] == "done" and facts["metrics"]["peak_N"] > 1.0 for facts in one.values())
    assert results(plan, tasks[::-1], tmp_path, 3) == one


def test_a_run_whose_warm_worker_is_killed_is_made_again_elsewhere(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500, 700]")
    first, task = plan.tasks
    common = job(plan, tmp_path)
    with WarmProcess(WORKER_JOB, common.limits) as process:
        assert run_facts(common, process, first)
        assert process._process is not None
        pid = process._process.pid
        # so that it cannot be ready before it is killed
        os.kill(pid, signal.SIGSTOP)
        threading.Timer(0.2, os.kill, (pid, signal.SIGKILL)).start()
        facts = run_facts(common, process, task)
        assert process._process.pid != pid
        again = run_facts(common, process, task)
    assert facts["status"] == "done" and facts["metrics"] == again["metrics"]


def test_letting_results_go_ends_every_process_at_once(hostile, tmp_path: Path):
    plan, tasks = hostile(3, {2: HANG, 3: HANG})
    before = children()
    with closing(LocalEngine(2).results(job(plan, tmp_path, limits=JobLimits(step=60.0)), tasks)) as batches:
        next(batches)
        assert len(children() - before) == 2
    assert children() == before


def test_a_full_disk_ends_the_sweep_and_what_was_finished_is_handed_over_first(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500, 700, 900]")
    place = tmp_path / "no_folder"
    place.write_text("")
    batches = LocalEngine(1).results(job(plan, place, "all"), list(plan.tasks))
    with pytest.raises(TwinError):
        list(batches)


def test_only_failures_are_recorded_if_only_those_are_asked_for(hostile, tmp_path: Path):
    plan, tasks = hostile(3, {2: SEGFAULT})
    found = results(plan, tasks, tmp_path / "runs", 1, record="failures")
    assert [found[run]["status"] for run in (1, 2, 3)] == ["done", "failed", "done"]
    assert sorted(path.relative_to(tmp_path / "runs").as_posix() for path in (tmp_path / "runs").rglob("*.*")) == [
        "000002/run.mcap.partial"
    ]
    assert results(plan, tasks[:1], tmp_path / "all", 1, record="all") == {1: found[1]}
    assert (tmp_path / "all" / "000001" / "run.mcap").exists()


def children() -> set[int]:
    """Processes that this one has begun and that have not ended."""
    begun = set()
    for task in Path("/proc/self/task").iterdir():
        # a thread may end while it is looked at
        with suppress(FileNotFoundError):
            begun |= {int(pid) for pid in (task / "children").read_text().split()}
    return begun
