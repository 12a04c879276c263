"""Rows, resuming and limits are the same whoever runs the runs: here an engine that only pretends to."""

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.kernel.recording.test_writer import largest_file
from tests.studies.sweep.definitions import STIFFNESS, stiffnesses
from twin.kernel.errors import InputRefused
from twin.studies.sweep.measures import RunFinding
from twin.studies.sweep.plan import SweepPlan, Task
from twin.studies.sweep.rows import ROWS, DiskFailed, read_rows, stored_sweep
from twin.studies.sweep.sweep import Job, Result, State, run_sweep

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
        return RunFinding("failed", "because", {}, float("nan"), float("nan")).facts
    stiffness = float(task.parameters[STIFFNESS])
    return RunFinding("done", "", {"force_error_N": stiffness, "peak_N": 1.0 / stiffness}, 0.1, 0.05).facts


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
    rows_before = len(read_rows(folder / ROWS))
    last = Pretender(order, batch)
    run_sweep(plan, folder, last)
    assert len(last.asked) == RUNS - rows_before
    assert stored_sweep(folder).rows == undisturbed
    assert (folder / ROWS).read_bytes().count(b"\n") == RUNS


def test_a_finished_sweep_runs_nothing_again(plan: SweepPlan, tmp_path: Path):
    run_sweep(plan, tmp_path, Pretender())
    again = Pretender()
    run_sweep(plan, tmp_path, again)
    assert len(stored_sweep(tmp_path).columns) == RUNS
    assert again.asked == []


def test_an_interruption_by_whoever_is_shown_the_state_lets_the_engine_go(plan: SweepPlan, tmp_path: Path):
    def show(state: State) -> None:
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
    size = (tmp_path / "all" / ROWS).stat().st_size
    with largest_file(size // 2), pytest.raises(DiskFailed, match=r"No space|File too large"):
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
    states: list[State] = []
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
    equal = RunFinding("done", "", {"force_error_N": 1.0}, 0.1, 0.05).facts
    monkeypatch.setitem(globals(), "facts", lambda task: equal)
    states: list[State] = []
    run_sweep(plan, tmp_path, Pretender(range(RUNS)[::-1], 5), show=states.append)
    assert [state.best and state.best[2] for state in states] == [None, 8, 3, 1]
