"""FMI 1.0 drives: run, reset, told what their standard has words for, and refused where it has not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.drive.first import first_description, first_drive, first_library
from tests.drive.test_component import TICK, made, run
from tests.drive.test_events import stepped
from twin.cli import drive_info
from twin.drive.description import described
from twin.drive.instance import Instance
from twin.drive.setup import Setup
from twin.drive.unpacked import unpacked
from twin.errors import ComponentFailed, InputRefused
from twin.experiment.schema import Drive
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned
from twin.runs.guard.reporter import DirectReporter
from twin.studies.qualify.lifecycle import examined
from twin.studies.qualify.proposal import proposal

VARIES = 'canHandleVariableCommunicationStepSize="true"'
LINES = 'canInterpolateInputs="true"'
Maker = Callable[..., Path]


@pytest.fixture(scope="module")
def first(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Makes drives of one binary; arguments as of `first_description`."""
    folder = tmp_path_factory.mktemp("first")
    library = first_library(root, folder)
    made: list[Path] = []

    def make(*said: str, **more: str) -> Path:
        made.append(folder / f"first_{len(made)}.fmu")
        return first_drive(library, made[-1], first_description(*said, **more))

    return make


def plan(fmu: Path, **table: Any) -> Any:
    return planned(Drive.model_validate({"fmu": str(fmu), **table})).until(100)


def test_it_turns_as_it_is_told(first: Maker):
    component = drive("drive_1", plan(first()), TICK, 0.25, 0.0)
    out = stepped(component, lambda t: 2.0, 100)
    # sums of 100 increments
    assert out["theta_m"] == pytest.approx(0.25 + 2.0 * TICK * np.arange(101), rel=1e-14)


def test_its_booleans_are_one_byte_wide(first: Maker):
    fmu = described(first())
    instance = Instance("a", fmu, unpacked(fmu.path, fmu.sha256), [(fmu.variables["enable"], 0.0)], (), Setup(stop=1.0))
    instance.write([(fmu.variables["omega_ref"], 1.0)])
    instance.advance(0.0, TICK)
    assert instance.read([fmu.variables[name] for name in ("enable", "omega_m")]).tolist() == [0.0, 0.0]
    instance.close()
    instance.close()


def test_a_run_after_a_reset_is_that_of_a_new_instance(first: Maker):
    assert (
        examined(DirectReporter(lambda note: None), Drive.model_validate({"fmu": str(first())}), "reset")["verdict"]
        == "ok"
    )


def test_its_status_is_a_number_and_what_it_logged_is_told(first: Maker):
    component = drive("drive_1", plan(first()), TICK, 0.0, 0.0)
    instance = component.instance  # type: ignore[attr-defined]
    with pytest.raises(ComponentFailed, match=r"fmiDoStep returned fmiError \('not initialised, no new step"):
        instance.advance(1.0, TICK)
    component.close()


def test_what_its_standard_does_not_fit_is_refused(first: Maker):
    with pytest.raises(InputRefused, match="needs its authoring tool"):
        described(first(kind="CoSimulation_Tool"))
    with pytest.raises(InputRefused, match=r"fmiInstantiate refused \(it said: the GUID is another one\)"):
        made(first(guid="{other}"))


def test_info_and_new_know_it(first: Maker):
    fmu = first()
    assert "FMI 1.0 co-simulation" in drive_info.text(plan(fmu))
    assert "steps of one size only" in drive_info.text(plan(fmu))
    assert drive_info.facts(plan(fmu))["fmus"][0]["get_set_state"] is False  # type: ignore[index]
    text, complete = proposal(described(fmu))
    assert complete and 'theta_m = "theta_m"' in text


def test_a_discarded_step_goes_on_where_it_got_to(first: Maker):
    told = {"parameters": {"longest": 0.3e-3}}
    component = drive("drive_1", plan(first(VARIES), **told), TICK, 0.0, 0.0)
    out = stepped(component, lambda t: 1.0, 100)
    # sums of 400 parts of steps
    assert out["theta_m"] == pytest.approx(TICK * np.arange(101), rel=1e-13)
    assert "it discards steps" in component.said()[0][1]
    component = drive("drive_1", plan(first(), **told), TICK, 0.0, 0.0)
    with pytest.raises(ComponentFailed) as failure:
        run(component, 1.0, 0.0)
    assert "fmiDoStep returned fmiDiscard; it may do with shorter steps: raise [drive] substeps" in str(failure.value)
    # as long as it takes: three steps of a third each
    fine = drive("drive_1", plan(first(), **told, substeps=4), TICK, 0.0, 0.0)
    assert stepped(fine, lambda t: 1.0, 100)["theta_m"][-1] == pytest.approx(0.1, rel=1e-13)


@pytest.mark.parametrize("longest", [1.0, 0.3e-3])
def test_an_input_that_rises_is_taken_as_a_line_within_the_step(first: Maker, longest: float):
    """Its slope is given with fmiSetRealInputDerivatives, and given again for every part of a discarded step."""
    told = {"parameters": {"longest": longest}}
    component = drive("drive_1", plan(first(f"{VARIES} {LINES}"), **told).with_lines(), TICK, 0.0, 0.0)
    out = stepped(component, lambda t: 2.0 * t, 100, inputs="linear")
    t = TICK * np.arange(101)
    # rounding of 400 sums
    assert out["omega_m"] == pytest.approx(2.0 * t, rel=1e-12)
    assert out["theta_m"] == pytest.approx(t**2, abs=1e-15)
    held = drive("drive_1", plan(first(VARIES)).with_lines(), TICK, 0.0, 0.0)
    late = stepped(held, lambda t: 2.0 * t, 100, inputs="linear")["omega_m"][1:]
    assert late == pytest.approx(2.0 * (t[1:] - 0.5 * TICK), rel=1e-12)
