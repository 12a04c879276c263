"""Model-exchange FMUs that go wrong: one sentence, and no hang."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.drive.exchange.conftest import Planner
from tests.drive.exchange.fmus import FAULTS, exchange_fmu
from twin.errors import ComponentFailed, InputRefused
from twin.experiment.schema import Drive
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned
from twin.studies.qualify.bench import response

TICKS = np.arange(100)
INPUTS = 3.0 * np.sin(0.04 * TICKS), np.zeros(100)
RUNNING = {
    "derivative is NaN": "said NaN or infinity for derivative 2 of 3",
    "event without end": "came to no end in an event at 0.05 s",
    "states grow": "wrote more states|has 4 continuous states after an event",
    "indicators flicker": "made more than 1000 events in one step",
    "event in the past": "asked at 0.05 s for a time event at -0.45 s, which is past",
    "indicator is NaN": "said NaN or infinity for event indicator 1 of 2",
    "event now, for ever": "made more than 1000 events in one step, the last at 0.05 s",
    "derivatives fail": r"fmi\dGet\w+ returned fmi\dError",
    "terminate": "asked to terminate the simulation",
    "too many states": "wrote more states, derivatives or event indicators than it says it has",
}
FLICKER = "indicators flicker"
STARTING = {
    "derivative is NaN": "says nan for number 2 of 3 at the start",
    "event without end": "its first event needs more than 1000 updates",
    "states grow": "writes more numbers than the 3|its binary has 4 continuous states",
    "event in the past": "asks for a time event at -0.5 s, before the start",
    "indicator is NaN": "says nan for number 1 of 2 at the start",
    "derivatives fail": r"fmi\dGet\w+ failed",
    "terminate": "cannot be brought into continuous-time mode: it asks to terminate",
    "too many states": "writes more numbers than the 3 that modelDescription.xml lists",
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("fault", "solver"),
    [(fault, solver) for fault in RUNNING for solver in ("cvode", "rk4") if (fault, solver) != (FLICKER, "rk4")],
)
def test_what_goes_wrong_in_a_run_ends_it_with_one_sentence(motor: Planner, fault: str, fmi: int, solver: str):
    plan = motor(fmi, solver=solver, fault=FAULTS[fault], fault_at=0.05, i_max=0.3)
    with pytest.raises(ComponentFailed, match=RUNNING[fault]) as failure:
        response(plan, *INPUTS)
    assert "\n" not in str(failure.value) and re.search(r"in the step from t = 0\.0(49|5) s", str(failure.value))


@pytest.mark.parametrize("fmi", [2, 3])
def test_indicators_that_flicker_do_not_hold_up_steps_of_one_length(motor: Planner, fmi: int):
    # looked at once per step: events that change nothing, one per step
    plan = motor(fmi, solver="rk4", fault=FAULTS[FLICKER], fault_at=0.05, i_max=0.3)
    assert len(response(plan, *INPUTS).t) == len(INPUTS[0])


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("fault", STARTING)
def test_what_is_wrong_at_the_start_is_refused(motor: Planner, fault: str, fmi: int):
    with pytest.raises(InputRefused, match=STARTING[fault]):
        drive("drive_1", motor(fmi, fault=FAULTS[fault]), 1e-3, 0.0, 0.0)


@pytest.mark.parametrize(
    ("fmi", "states", "said"),
    [
        (2, 2, "writes more numbers than the 2"),
        (2, 4, "writes fewer numbers than the 4"),
        (2, 1001, "1001 continuous states; a drive may have 1000"),
        (3, 2, "its binary has 3 continuous states, its modelDescription.xml lists 2"),
    ],
)
def test_a_number_of_states_that_is_not_the_binarys_is_refused(exchange_folder: Path, fmi: int, states: int, said: str):
    plan = planned(Drive.model_validate({"fmu": str(exchange_fmu(exchange_folder, "motor", fmi, states))}))
    with pytest.raises(InputRefused, match=said):
        drive("drive_1", plan, 1e-3, 0.0, 0.0)
