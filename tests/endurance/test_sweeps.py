"""A worker of a sweep for ten thousand runs: `make endurance`."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.studies.sweep.definitions import job, stiffness_text, written
from twin.kernel.process.warm import WarmProcess
from twin.studies.sweep import WORKER_JOB
from twin.studies.sweep.engine import run_facts
from twin.studies.sweep.plan import read_plan

pytestmark = [
    pytest.mark.endurance,
    pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads memory from /proc"),
]

RUNS = 10_000
MB = 1e6


@pytest.mark.parametrize("drive", ["velocity_servo", "torque_motor_fmi3"])
def test_ten_thousand_runs_in_one_process_neither_leak_nor_need_much(root: Path, tmp_path: Path, drive: str):
    text = stiffness_text(root, "[500]", f'drives = ["{drive}"]').replace("0.02", "2.0")
    plan = read_plan(written(tmp_path, text))
    (task,) = plan.tasks
    memory: list[float] = []
    common = job(plan, tmp_path)
    with WarmProcess(WORKER_JOB, common.limits) as process:
        for run in range(1, RUNS + 1):
            stiffness = f"contact.stiffness_N_per_m={500 + run}"
            facts = run_facts(common, process, replace(task, run=run, settings=(*task.settings, stiffness)))
            assert facts["status"] == "done"
            if run % 1000 == 0:
                memory.append(process.memory)
    print(drive, [round(value / MB, 2) for value in memory])
    # the first thousand fill caches and allocators
    assert memory[-1] - memory[0] < (len(memory) - 1) * 1.0 * MB
    assert max(memory) < 350 * MB
