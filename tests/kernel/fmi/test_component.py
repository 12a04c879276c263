from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import altered, redescribed
from tests.kernel.fmi.warning import warning_drive
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import described
from twin.kernel.fmi.groups import DO_STEP_FAILED
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.lifecycle import CosimInstance
from twin.kernel.fmi.stepping import Stepping
from twin.kernel.fmi.unpacked import unpacked
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.schema import Drive

TICK = 1e-3


class Bench:
    """Commands a speed and holds a load."""

    inputs = ()
    outputs = (Port("omega_ref", 1, "rad/s"), Port("tau_load", 1, "N m"))
    sampled = True

    def __init__(self, omega_ref: float, tau_load: float):
        self.values = omega_ref, tau_load

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[:] = self.values


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def made(fmu: Path, name: str = "drive_1", theta_m: float = 0.0, **table: Any) -> Component:
    return drive(name, plan_drive(Drive.model_validate({"fmu": str(fmu), **table})), TICK, theta_m, 0.0)


def run(component: Component, omega_ref: float, tau_load: float, ticks: int = 1000) -> dict[str, np.ndarray]:
    bench = PythonComponent("bench", Bench(omega_ref, tau_load))
    wires = [("bench.omega_ref", f"{component.name}.omega_ref"), ("bench.tau_load", f"{component.name}.tau_load")]
    system = System([bench, component], wires, TICK)
    try:
        rows = Simulation(system, ticks).run()
    finally:
        component.close()
    return {p.name: rows[:, system.columns(f"{component.name}.{p.name}")][:, 0] for p in component.outputs}


def test_the_servo_settles_at_the_command_less_droop_times_load(servo: Path):
    out = run(made(servo, parameters={"droop": 0.5}), 2.0, 0.1)
    # 50 time constants after the step
    assert out["omega_m"][-1] == pytest.approx(2.0 - 0.5 * 0.1, rel=1e-12)


def test_the_shaft_is_coupled_at_the_angle_it_starts_with(root: Path):
    out = run(made(root / "fmus/ideal_velocity/ideal_velocity.fmu", theta_m=0.75), 2.0, 0.0)
    assert out["theta_m"][0] == 0.75
    # sums of 1,000 rounded increments
    assert out["theta_m"][-1] == pytest.approx(0.75 + 2.0 * 1.0, abs=1e-12)


def test_a_drive_is_initialised_under_the_load_that_it_has_and_without_a_command(root: Path, servo: Path):
    plain = drive("drive_1", plan_drive(Drive.model_validate({"fmu": str(servo)})), TICK, 0.0, 0.25)
    assert inside(plain, "tau_load") == 0.25 and inside(plain, "omega_ref") == 0.0
    geared = plan_drive(Drive.model_validate({"fmu": str(servo), "sign": -1, "gear_ratio": 10.0}))
    # a shaft that turns ten times as fast, the other way, carries a tenth; exact but for rounding
    assert inside(drive("drive_1", geared, TICK, 0.0, 0.25), "tau_load") == pytest.approx(-0.025, rel=1e-15)


def test_each_drive_of_a_robot_starts_under_the_load_of_its_own_spring(root: Path):
    with assemble(load_experiment(root / "experiments" / "step_joint_1_side.toml")) as assembly:
        components = {component.name: component for component in assembly.system.components}
        loads = components["plant"].initial("tau_load")
        assert len(set(np.abs(loads).round(3))) == 3, "the pose makes three different loads"
        assert [inside(components[f"drive_{i}"], "tau_load") for i in (1, 2, 3)] == loads.tolist()


def inside(component: Component, name: str) -> float:
    """The variable `name` of the FMU behind `component`, in its own unit."""
    assert isinstance(component, FmuComponent)
    instance = component.instance
    return float(instance.read_floats([instance.description.variables[name]])[0])


def test_drives_of_one_file_do_not_share_their_state(servo: Path):
    both = [made(servo, f"drive_{i}") for i in (1, 2)]
    first, second = (run(component, speed, 0.0) for component, speed in zip(both, (1.0, 2.0), strict=True))
    assert second["omega_m"][-1] == pytest.approx(2 * first["omega_m"][-1])


def test_sign_and_gear_turn_the_fmus_shaft_but_not_what_the_robot_sees(servo: Path):
    """A servo behind a gear of 10 that turns backwards: same speed for the robot, a 100th of the droop."""
    plain = run(made(servo), 0.5, 0.1)["omega_m"][-1]
    geared = run(made(servo, sign=-1, gear_ratio=10.0), 0.5, 0.1)["omega_m"][-1]
    assert geared == pytest.approx(0.5 - 0.6 * 0.1 / 100, rel=1e-12)
    assert plain == pytest.approx(0.5 - 0.6 * 0.1, rel=1e-12)


def test_foreign_units_come_out_as_si(tmp_path: Path, servo: Path):
    """The same FMU with its speeds declared in units of 2 rad/s: the robot gets what it asks for, and 2 rad per rad."""
    base = 'rad="1" s="-1"'
    other = redescribed(servo, tmp_path / "other.fmu", f"<BaseUnit {base} />", f'<BaseUnit {base} factor="2" />')
    out = run(made(other, parameters={"droop": 0.0}), 1.0, 0.0)
    assert out["omega_m"][-1] == pytest.approx(1.0, rel=1e-12)
    # the angle is declared in rad still and follows the 0.5 that the FMU itself sees, a time constant late
    assert out["theta_m"][-1] == pytest.approx(0.5 * (1.0 - 0.02), rel=1e-9)


def test_sub_stepping_an_exactly_solved_drive_changes_nothing(servo: Path):
    coarse, fine = run(made(servo), 1.0, 0.1), run(made(servo, substeps=8), 1.0, 0.1)
    # rounding of eight short steps instead of one
    assert np.allclose(coarse["theta_m"], fine["theta_m"], rtol=0, atol=1e-13)


def test_two_fmus_wired_together_are_one_drive(root: Path):
    """An ideal velocity source whose speed commands a second one through a wire, one inner step later."""
    ideal = str(root / "fmus/ideal_velocity/ideal_velocity.fmu")
    table: dict[str, Any] = {
        "parts": {"source": {"fmu": ideal}, "shaft": {"fmu": ideal}},
        "wires": {"shaft.omega_ref": "source.omega_m", "source.tau_load": "shaft.theta_m"},
        "inputs": {"omega_ref": "source.omega_ref", "tau_load": "shaft.tau_load"},
        "outputs": {"theta_m": "shaft.theta_m", "omega_m": "shaft.omega_m"},
    }
    with pytest.raises(InputRefused, match="have different dimensions"):
        plan_drive(Drive.model_validate(table))
    del table["wires"]["source.tau_load"]
    component = drive("drive_1", plan_drive(Drive.model_validate(table)), TICK, 0.25, 0.0)
    out = run(component, 2.0, 0.0, 100)
    assert out["omega_m"][-1] == 2.0
    assert out["theta_m"][-1] == pytest.approx(0.25 + 0.2, abs=1e-12)


def test_a_voltage_drive_gets_a_velocity_loop_in_front_of_it(root: Path):
    folder = root / "fmus" / "brushed_dc"
    table: dict[str, Any] = {
        "command": "voltage",
        "inputs": {"command": "u_cmd", "tau_load": "M_load"},
        "outputs": {"theta_m": "phi", "omega_m": "n"},
        "velocity_loop": {"kp": 3.0, "ki": 300.0, "limit": 24.0, "period_ms": 0.25},
    }
    out = run(made(folder / "brushed_dc.fmu", **table), 0.5, 0.05)
    # an integrator leaves no error; the duty of its bridge has steps
    assert out["omega_m"][-100:].mean() == pytest.approx(0.5, rel=0.01)
    assert "command" in out


def test_rates_that_do_not_fit_are_refused(root: Path):
    table: dict[str, Any] = {
        "command": "voltage",
        "inputs": {"command": "u_cmd", "tau_load": "M_load"},
        "outputs": {"theta_m": "phi", "omega_m": "n"},
        "velocity_loop": {"kp": 3.0, "limit": 24.0, "period_ms": 0.3},
    }
    with pytest.raises(InputRefused, match=r"period_ms = 0.3 does not divide"):
        made(root / "fmus/brushed_dc/brushed_dc.fmu", **table)


def test_a_pinned_hash_that_differs_is_refused_before_loading(servo: Path):
    with pytest.raises(InputRefused, match="the experiment pins 00"):
        plan_drive(Drive.model_validate({"fmu": str(servo), "sha256": "00"}))


def test_direct_feed_through_of_the_load_is_explained(tmp_path: Path, servo: Path):
    plain = plan_drive(Drive.model_validate({"fmu": str(servo)}))
    assert plain.warnings() == []
    fed = redescribed(servo, tmp_path / "fed.fmu", 'dependencies=""', 'dependencies="2"')
    (warning, *_) = plan_drive(Drive.model_validate({"fmu": str(fed)})).warnings()
    assert "depends directly on tau_load" in warning
    assert "algebraic loop" in warning


def test_a_wrong_guid_is_refused_with_the_reason(servo: Path, tmp_path: Path):
    guid = plan_drive(Drive.model_validate({"fmu": str(servo)})).parts[""].model.guid
    bad = redescribed(servo, tmp_path / "bad.fmu", guid, "{00000000-0000-0000-0000-000000000000}")
    with pytest.raises(InputRefused, match="fmi2Instantiate refused") as refused:
        made(bad)
    assert "bad.fmu" in str(refused.value)
    assert "GUID" in str(refused.value)


def test_a_library_that_does_not_load_is_refused_and_leaves_us_where_we_were(servo: Path, tmp_path: Path):
    bad = altered(servo, tmp_path / "bad.fmu", lambda n, c: (n, b"no library" if n.startswith("binaries/") else c))
    here = Path.cwd()
    with pytest.raises(InputRefused, match="its binary does not load"):
        made(bad)
    assert Path.cwd() == here


def test_the_fast_step_and_the_general_step_do_the_same_bit_for_bit(servo: Path, monkeypatch: pytest.MonkeyPatch):
    fast = run(made(servo, theta_m=0.3), 1.0, 0.1)
    monkeypatch.setattr(Stepping, "_is_plain", lambda *arguments: False)
    general = run(made(servo, theta_m=0.3), 1.0, 0.1)
    assert all(np.array_equal(fast[name], general[name]) for name in fast)


def test_what_a_drive_logs_is_told_once_with_the_tick_of_the_step(root: Path, tmp_path: Path):
    component = made(warning_drive(root, tmp_path, 0.25))
    run(component, 1.0, 0.0, 400)
    assert component.take_messages() == [(250, "the winding is hot")]
    assert component.take_messages() == []


def test_a_silent_drive_has_nothing_to_say(servo: Path):
    component = made(servo)
    run(component, 1.0, 0.0, 10)
    assert component.take_messages() == []


def test_what_one_drive_logs_is_not_said_by_another(root: Path, tmp_path: Path):
    fmu = warning_drive(root, tmp_path, 0.25)
    first, second = made(fmu, "drive_1"), made(fmu, "drive_2")
    run(first, 1.0, 0.0, 400)
    assert (first.take_messages(), second.take_messages()) == ([(250, "the winding is hot")], [])
    second.close()


def test_a_failure_is_explained_with_what_the_drive_said_last(servo: Path):
    component = made(servo)
    assert isinstance(component, FmuComponent)
    assert component.explain(DO_STEP_FAILED + 3) == "fmi2DoStep returned fmi2Error"
    for said in (b"warm", b"hot", b"on fire"):
        component.instance.on_message(1, said)
        assert component.explain(DO_STEP_FAILED + 3) == f"fmi2DoStep returned fmi2Error ('{said.decode()}')"
    component.close()


def test_what_a_drive_logs_as_ok_is_not_kept(servo: Path):
    component = made(servo)
    assert isinstance(component, FmuComponent)
    component.instance.on_message(0, b"all is well")
    assert component.take_messages() == [] and component.instance.messages == []
    component.close()


def test_a_switch_of_a_drive_is_on_or_off_as_it_was_set(root: Path):
    fmu = described(root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu")
    enable = fmu.variables["enable"]
    for on in (1.0, 0.0):
        instance = CosimInstance("drive_1", fmu, unpacked(fmu.path, fmu.sha256), settings=[(enable, on)])
        assert instance.read_floats([enable]).tolist() == [on]
        instance.close()


def test_what_an_fmu_says_again_and_again_is_quoted_once():
    instance = Instance.__new__(Instance)
    instance.messages, instance.pending_messages, instance.clock = [], [], np.zeros(1, dtype=np.int64)
    for text in (b"a", b"expired", b"expired", b"b", b"expired\n"):
        instance.on_message(3, text)
    assert instance.messages == ["a", "b", "expired"]
