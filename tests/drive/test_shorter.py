"""FMI 2.0: a discarded step is gone on with from where the FMU got to, or the run ends with a sentence."""

from pathlib import Path

import numpy as np
import pytest

from tests.drive.compiled import compiled_drive
from tests.drive.test_component import TICK, made, run
from tests.drive.test_events import stepped
from twin.drive.stepping import Stepping
from twin.errors import ComponentFailed

TRICKS = {"honest": 1, "none": 2, "nan": 3, "beyond": 4, "silent": 5, "ends": 6, "coarse": 7}
"""What the parameter `droop` of the drive below stands for."""


def discards(text: str) -> str:
    """lifecycle.c that discards steps of more than 0.3 ms, having made 0.3 ms of them, and tells of it as `droop` says.

    1: as it is. 2: it has made nothing. 3: NaN. 4: later than was asked. 5: it does not say. 6: it wants to end.
    7: it has made nothing, and makes 0.3 ms and less. All but 1 and 7 from t = 0.01 s on.
    """
    step = "fmi2Status fmi2DoStep("
    text = text.replace(step, "static fmi2Status honest_step(").replace(
        "fmi2Status fmi2GetRealStatus(", "fmi2Status real("
    )
    text = text.replace("fmi2Status fmi2GetBooleanStatus(", "static fmi2Status boolean(")
    return (
        text
        + """
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b)
{
    Slave *slave = c;
    const int trick = (int)slave->state.v.droop;
    if (fabs(t - slave->state.time) > 1e-12)
        return refuse(slave, "not where the last step ended");
    if (h < 0.3e-3 * (1.0 + 1e-9) || (trick != 1 && trick != 7 && t < 0.0095))
        return trick == 2 && t > 0.0095 ? fmi2Discard : honest_step(c, t, h, b);
    if (trick != 2 && trick != 7 && honest_step(c, t, 0.3e-3, b) != fmi2OK)
        return fmi2Error;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    const Slave *slave = c;
    const int trick = (int)slave->state.v.droop;
    *value = trick == 3 ? NAN : slave->state.time + (trick == 4 ? 1.0 : 0.0);
    return kind == fmi2LastSuccessfulTime && trick != 5 ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    *value = kind == fmi2Terminated && (int)((Slave *)c)->state.v.droop == 6;
    return fmi2OK;
}
"""
    )


@pytest.fixture(scope="module")
def servo(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_drive(root, tmp_path_factory.mktemp("shorter"), "shorter", {"lifecycle.c": discards})


@pytest.mark.parametrize("trick", ["honest", "coarse"])
@pytest.mark.parametrize("plain", [True, False])
def test_a_discarded_step_comes_to_the_same_as_a_whole_one(
    root: Path, servo: Path, monkeypatch: pytest.MonkeyPatch, trick: str, plain: bool
):
    monkeypatch.setattr(Stepping, "_is_plain", lambda *arguments: plain)
    told = {"droop": TRICKS[trick]}
    component = made(servo, parameters=told)
    whole = made(root / "fmus" / "velocity_servo" / "velocity_servo.fmu", parameters=told)
    parts, one = (stepped(c, lambda t: 1.0 + 100.0 * t, 100) for c in (component, whole))
    # rounding of four steps of an exactly solved drive instead of one
    assert np.allclose(parts["theta_m"], one["theta_m"], rtol=0, atol=1e-14)
    ((_, said),) = component.said()
    assert said == "it discards steps, which are then made in parts, since t = 0 s"


@pytest.mark.parametrize(
    ("trick", "said"),
    [
        ("none", "fmi2DoStep returned fmi2Discard and stays at t = 0.01 s, however short its steps"),
        ("nan", "fmi2DoStep says that it went on until t = nan s, which lies outside of this step"),
        ("beyond", "fmi2DoStep says that it went on until t = 1.0103 s, which lies outside of this step"),
        ("silent", "fmi2DoStep returned fmi2Discard; it may do with shorter steps: raise [drive] substeps"),
        ("ends", "fmi2DoStep asked to terminate the simulation"),
    ],
)
def test_a_discarded_step_that_leads_nowhere_ends_the_run_with_a_sentence(servo: Path, trick: str, said: str):
    with pytest.raises(ComponentFailed) as failure:
        run(made(servo, parameters={"droop": TRICKS[trick]}), 1.0, 0.0, 100)
    assert said in str(failure.value)
    assert "in the step from t = 0.01 s, tick 10." in str(failure.value)


def test_a_tick_that_fits_is_not_discarded(servo: Path):
    component = made(servo, parameters={"droop": TRICKS["honest"]}, substeps=4)
    assert stepped(component, lambda t: 1.0, 10)["theta_m"][-1] > 0.0
    assert component.said() == []
    assert TICK / 4 < 0.3e-3
