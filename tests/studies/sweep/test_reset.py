"""Drives that are reset for the next run give the rows of new ones, bit for bit; those that would not are refused."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.drive.compiled import compiled_drive
from tests.studies.sweep.definitions import stiffnesses
from tests.studies.sweep.test_pool import results
from tests.studies.sweep.test_sweep import Pretender
from twin.errors import InputRefused
from twin.studies.sweep.sweep import run_sweep

RESTORE = "    restore_start_values(&((Slave *)c)->state);\n    return fmi2OK;"
FORGETFUL = "    ((Slave *)c)->state.mode = INSTANTIATED;\n    return fmi2OK;"


def test_rows_after_a_reset_are_those_of_new_instances(root: Path, tmp_path: Path):
    # FMI 2.0, and 3.0 behind a velocity loop of ours
    more = 'drives = ["pmsm_foc", "torque_motor_fmi3"]\nreuse = "reset"'
    plan = stiffnesses(root, tmp_path, "[500, 900, 1300]", more)
    # long enough to touch the scale
    tasks = [replace(task, settings=(*task.settings, "duration_s=8")) for task in plan.tasks]
    kept = results(plan, tasks, tmp_path, 1)
    anew = replace(plan, definition=plan.definition.model_copy(update={"reuse": None}))
    fresh = results(anew, tasks, tmp_path, 1)
    assert all(facts["status"] == "done" and facts["metrics"]["peak_N"] > 1.0 for facts in fresh.values())
    assert kept == fresh


def test_a_drive_that_remembers_is_refused_before_anything_has_run(root: Path, tmp_path: Path):
    bad = compiled_drive(root, tmp_path, "bad", {"lifecycle.c": lambda text: text.replace(RESTORE, FORGETFUL)})
    plan = stiffnesses(root, tmp_path, "[500, 900]", f'drives = ["velocity_servo", "{bad}"]\nreuse = "reset"')
    engine = Pretender()
    with pytest.raises(InputRefused) as refused:
        run_sweep(plan, tmp_path / "out", engine)
    said = "bad.fmu: a run after reset is another one; leave reuse out, and each run gets new instances"
    assert str(refused.value) == f's: reuse = "reset": {said}'
    assert not engine.asked and not (tmp_path / "out").exists()


def test_drives_that_repeat_bit_for_bit_are_let_through(root: Path, tmp_path: Path):
    plan = stiffnesses(root, tmp_path, "[500, 900]", 'drives = ["velocity_servo", "stepper"]\nreuse = "reset"')
    engine = Pretender()
    run_sweep(plan, tmp_path / "out", engine)
    assert [task.run for task in engine.asked] == [1, 2, 3, 4]
