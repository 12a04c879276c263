"""The check of what a drive does within its steps; what the FMU does is said in eventful.c."""

from pathlib import Path
from typing import Any

import pytest

from tests.drive.eventful import KINDS, READ, WITHIN, Maker
from twin.experiment.schema import Drive
from twin.runs.assembly.drives import planned
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Check
from twin.studies.qualify.qualification import qualified
from twin.studies.qualify.text import check_text
from twin.studies.qualify.within import Excursion, within_check
from twin.studies.qualify.work_cycle import work_cycle

STRAYS = {"kind": KINDS["strays"], "period": 0.213, "stop": 1e-3}
FAR = 0.75e-3
"""rad. A bulge of 1 mrad in the middle of a step, after which another 0.25 mrad are to be turned."""


def table(fmu: Path, parameters: dict[str, Any], **more: Any) -> Drive:
    return Drive.model_validate({"fmu": str(fmu), "parameters": parameters, **more})


def looked_at(drive: Drive, apart: bool = False) -> tuple[Check, tuple[Excursion, ...], Response]:
    plan = planned(drive)
    cycle = response(plan, *work_cycle())
    return *within_check(plan, cycle, apart), cycle


def test_a_qualification_tells_how_far_an_output_strays_within_a_step(shaft: Maker):
    done = qualified(table(shaft(WITHIN, theta_m=READ), STRAYS))
    facts = done.facts()
    assert facts["qualified"]
    (found,) = facts["within"]
    # rounding of sums of angles
    assert found.pop("beyond") == pytest.approx(FAR, abs=1e-15)
    assert found.pop("t") == pytest.approx(0.2135, rel=1e-12)
    assert found == {"output": "theta_m", "unit": "rad", "reads": 4.0}
    said = "beyond what it is at both ends of a step: theta_m by up to 0.00075 rad at 0.2135 s. 4 updates a step"
    assert facts["checks"]["within"]["verdict"] == "ok" and facts["checks"]["within"]["detail"] == said
    assert said in " ".join(check_text(facts).split())


def test_it_is_told_in_the_contracts_units_and_of_steps_that_are_finer_than_a_tick(shaft: Maker):
    """Behind a gear of 2 the shaft turns half as far as the FMU's; two steps make a tick."""
    check, (found,), _ = looked_at(table(shaft(WITHIN, theta_m=READ), STRAYS, substeps=2, gear_ratio=2.0))
    assert check.verdict == "ok"
    assert found.unit == "rad" and found.reads == 4.0
    assert found.beyond == pytest.approx(0.5e-3 - 0.125e-3, abs=1e-15)


def test_in_a_process_of_its_own_it_is_the_same(shaft: Maker):
    drive = table(shaft(WITHIN, theta_m=READ), STRAYS)
    assert looked_at(drive, apart=True)[:2] == looked_at(drive)[:2]


def test_an_fmu_that_cannot_be_read_when_it_may_gets_a_note_and_qualifies(shaft: Maker):
    done = qualified(table(shaft(WITHIN, theta_m=READ), {"kind": KINDS["shuts"]}))
    (check,) = (check for check in done.checks if check.name == "within")
    assert not done.failed and done.within == ()
    assert check.verdict == "note" and "fmi3GetFloat64 within a step returned fmi3Error" in check.detail


def test_an_fmu_that_moves_otherwise_when_it_is_read_gets_a_note(shaft: Maker):
    """Here a work cycle at another speed stands for the one in which it was not read."""
    plan = planned(table(shaft(WITHIN, theta_m=READ), STRAYS))
    cycle = response(plan, *work_cycle(speed=0.4))
    check, _ = within_check(plan, cycle, apart=False)
    assert check.verdict == "note" and check.detail.endswith("being read changes theta_m or omega_m")
