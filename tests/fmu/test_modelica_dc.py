"""modelica_dc.fmu: the equations of its Modelica source, stepped as its compiler steps them and solved by scipy."""

import sys
import zipfile
from importlib.util import find_spec
from math import tanh
from pathlib import Path

import build
import numpy as np
import pytest
from builder.modelica import pack_modelica_drive
from builder.references import carry_references
from fmpy.fmi1 import FMICallException
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.conftest import examples

from .rig import FMUS, Rig, described, fmu_path
from .spring_sweep import mapped_loop, mapping, swept

DRIVE = "modelica_dc"
R_0, L_A, R_F, L_F, K = 1.5, 1.5e-3, 240.0, 10.0, 1.0
J_M, B_M, TAU_C, OMEGA_C = 1e-4, 1e-4, 0.004, 0.1
ALPHA, T_0, R_TH, C_TH = 0.0039, 293.15, 6.0, 30.0
STATES = ["i_a", "i_f", "omega_m", "theta_m", "T_w"]

volts = st.floats(-24.0, 24.0)
loads = st.floats(-0.6, 0.6)


def rates(t: float, x: np.ndarray, v_a: float, v_f: float, tau_load: float) -> np.ndarray:
    """(1) to (7): rates of STATES."""
    i_a, i_f, omega, _, T_w = x
    R_a = R_0 * (1 + ALPHA * (T_w - T_0))
    friction = B_M * omega + TAU_C * tanh(omega / OMEGA_C)
    return np.array(
        [
            (v_a - R_a * i_a - K * i_f * omega) / L_A,
            (v_f - R_F * i_f) / L_F,
            (K * i_f * i_a - tau_load - friction) / J_M,
            omega,
            (R_a * i_a**2 - (T_w - T_0) / R_TH) / C_TH,
        ]
    )


def states(drive: Rig) -> np.ndarray:
    return np.array([drive[name] for name in STATES])


def from_rest() -> np.ndarray:
    return np.array([0.0, 0.1, 0.0, 0.0, T_0])


@examples(40)
@given(v_a=volts, v_f=st.floats(0.0, 24.0), tau_load=loads, h=st.floats(1e-5, 2e-3))
def test_a_step_is_ten_forward_euler_steps(v_a: float, v_f: float, tau_load: float, h: float) -> None:
    x = from_rest()
    with Rig(DRIVE).start(v_a=v_a, v_f=v_f, tau_load=tau_load) as drive:
        drive.step(h)
        for _ in range(10):
            x = x + h / 10 * rates(0.0, x, v_a, v_f, tau_load)
        # another order of the same operations, and ten roundings of time
        assert states(drive) == pytest.approx(x, rel=1e-9, abs=1e-12)
        assert drive["tau_motor"] == pytest.approx(K * x[1] * x[0], rel=1e-9, abs=1e-12)


def test_it_approaches_the_solution_in_proportion_to_the_step() -> None:
    inputs = (1.0, 24.0, 0.03)
    exact = solve_ivp(rates, (0.0, 0.02), from_rest(), "DOP853", args=inputs, rtol=1e-11, atol=1e-14).y[:, -1]
    errors = []
    for steps in (40, 80, 160):
        with Rig(DRIVE).start(v_a=inputs[0], tau_load=inputs[2]) as drive:
            drive.run(0.02 / steps, steps)
            errors.append(np.abs(states(drive) - exact)[[0, 2, 3]])
    # current, speed, angle: order 1 halves the error; terms of order 2 are a few percent of it at these steps
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.05)


def test_steps_beyond_twenty_electrical_time_constants_diverge_and_still_report_success() -> None:
    for h, finite in ((18e-3, True), (22e-3, False)):
        with Rig(DRIVE).start(v_a=1.0) as drive:
            drive.run(h, 50)
            assert np.isfinite(drive["i_a"]) == finite


def test_steady_speed_spends_the_voltage_on_resistance_and_back_emf() -> None:
    with Rig(DRIVE).start(v_a=2.0, tau_load=0.05) as drive:
        drive.run(1e-3, 400)
        i_a, i_f, omega, _, T_w = states(drive)
        # settled to 1e-6: 25 mechanical time constants are over, the winding's 180 s go on
        assert R_0 * (1 + ALPHA * (T_w - T_0)) * i_a + K * i_f * omega == pytest.approx(2.0, rel=1e-5)
        friction = B_M * omega + TAU_C * tanh(omega / OMEGA_C)
        assert drive["tau_motor"] == pytest.approx(0.05 + friction, rel=1e-5)


def test_half_the_field_takes_twice_the_current() -> None:
    currents = {}
    for v_f in (24.0, 12.0):
        with Rig(DRIVE).start(v_a=2.0, v_f=v_f, tau_load=0.05) as drive:
            drive.run(1e-3, 1500)
            friction = B_M * drive["omega_m"] + TAU_C * tanh(drive["omega_m"] / OMEGA_C)
            currents[v_f] = drive["i_a"] / (0.05 + friction)
    assert currents[12.0] == pytest.approx(2 * currents[24.0], rel=1e-4)  # 35 field time constants of 42 ms are over


def test_a_stalled_armature_heats_until_the_housing_takes_it_all() -> None:
    with Rig(DRIVE).start(v_a=1.5, tau_load=0.0, J_m=1e6, C_th=0.01) as drive:
        drive.run(1e-3, 2000)
        i_a, T_w = drive["i_a"], drive["T_w"]
        loss = R_0 * (1 + ALPHA * (T_w - T_0)) * i_a**2
        assert T_w - T_0 == pytest.approx(R_TH * loss, rel=1e-6)  # 33 time constants of 60 ms are over
        assert T_w - T_0 > 5.0


def test_positive_load_drives_the_shaft_backwards() -> None:
    with Rig(DRIVE).start(tau_load=0.1) as drive:
        drive.step(0.5e-3)
        # friction and back-EMF are below 5 % of the load
        assert drive["omega_m"] == pytest.approx(-0.1 / J_M * 0.5e-3, rel=0.05)


def test_the_mapped_velocity_loop_winds_the_spring() -> None:
    roles = mapping(DRIVE)
    with Rig(DRIVE).start() as drive:
        omega_ref, omega_m = swept(drive, roles["inputs"] | roles["outputs"], mapped_loop(DRIVE), 5.0).T
    # the README's 0.012 rad/s: R_a d tau_load/dt / (K i_f ki) and friction
    assert np.max(np.abs(omega_ref - omega_m)) < 0.013
    # nothing rings: from tick to tick the speed changes by less than friction's reversal makes it
    assert np.max(np.abs(np.diff(omega_m))) < 0.005


def test_three_instances_do_not_share_memory() -> None:
    with Rig(DRIVE).start(v_a=0.4) as alone:
        alone.run(1e-3, 30)
        expected = alone.values()
    with Rig(DRIVE) as one, Rig(DRIVE) as two, Rig(DRIVE) as three:
        for drive, v_a in ((one, 0.4), (two, -7.0), (three, 2.0)):
            drive.start(v_a=v_a)
        for _ in range(30):
            for drive in (one, two, three):
                drive.step(1e-3)
        assert one.values() == expected


def test_a_wrong_guid_is_refused() -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        Rig(DRIVE, guid="{00000000-0000-0000-0000-000000000000}")


def test_no_state_can_be_saved() -> None:
    assert not described(DRIVE).coSimulation.canGetAndSetFMUstate
    with Rig(DRIVE).start() as drive, pytest.raises(FMICallException):
        drive.slave.getFMUstate()


def test_states_are_local_to_the_description_although_the_source_makes_them_outputs() -> None:
    causalities = {v.name: v.causality for v in described(DRIVE).modelVariables}
    assert [causalities[name] for name in ("theta_m", "omega_m", "i_a", "T_w")] == ["local"] * 4
    assert causalities["tau_motor"] == "output"
    assert described(DRIVE).unitDefinitions == []


def test_the_mapping_names_variables_of_the_fmu() -> None:
    names = {v.name for v in described(DRIVE).modelVariables}
    roles = mapping(DRIVE)
    assert {*roles["inputs"].values(), *roles["outputs"].values()} <= names


def test_the_fmu_holds_this_source_and_this_readme() -> None:
    stale = "fmus/modelica_dc/modelica_dc.fmu is stale: run python fmus/build.py modelica_dc"
    with zipfile.ZipFile(fmu_path(DRIVE)) as archive:
        assert archive.read("sources/ModelicaDC.mo") == (FMUS / DRIVE / "ModelicaDC.mo").read_bytes(), stale
        assert archive.read("documentation/README.md") == (FMUS / DRIVE / "README.md").read_bytes(), stale


def test_building_without_its_tools_names_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build, "find_spec", lambda tool: None)
    monkeypatch.setattr(sys, "argv", ["build.py", DRIVE])
    with pytest.raises(SystemExit):
        build.main()
    assert "drive 'modelica_dc' is made with rumoca and ziglang: pip install .[fmus]" in capsys.readouterr().err


# a minute of compiling C++
@pytest.mark.endurance
@pytest.mark.skipif(find_spec("rumoca") is None or find_spec("ziglang") is None, reason="no tools: pip install .[fmus]")
def test_rebuilding_gives_the_same_bytes(tmp_path: Path) -> None:
    pack_modelica_drive(DRIVE, tmp_path / "scratch", tmp_path / "rebuilt.fmu")
    carry_references(DRIVE, tmp_path / "rebuilt.fmu")
    assert (tmp_path / "rebuilt.fmu").read_bytes() == fmu_path(DRIVE).read_bytes()
