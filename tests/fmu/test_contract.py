"""What every drive promises to the robot, whatever is inside it."""

import pytest

from .rig import DRIVES, Rig, described

CONTRACT = {
    "omega_ref": ("input", "rad/s"),
    "tau_load": ("input", "N.m"),
    "theta_m": ("output", "rad"),
    "omega_m": ("output", "rad/s"),
}
OPTIONAL = {"tau_motor": ("output", "N.m"), "current": ("output", "A")}

# steady loss of speed per torque of load, rad/(s N m)
DROOP = {"ideal_velocity": 0.0, "pmsm_foc": 0.0, "velocity_servo": 0.6}

pytestmark = pytest.mark.parametrize("drive", DRIVES)


def test_ports_have_the_contract_names_causalities_and_units(drive: str) -> None:
    ports = {
        v.name: (v.causality, v.unit)
        for v in described(drive).modelVariables
        if v.causality in ("input", "output")
    }
    assert ports.items() >= CONTRACT.items()
    assert ports.items() <= (CONTRACT | OPTIONAL).items()


def test_outputs_start_at_zero(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5, tau_load=0.1) as rig:
        for variable in described(drive).modelVariables:
            if variable.causality == "output":
                assert rig[variable.name] == 0.0


def test_inputs_move_outputs_only_through_a_step(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5) as rig:
        rig.run(1e-3, 5)
        before = {name: rig[name] for name in CONTRACT if name.endswith("_m")}
        rig["omega_ref"] = -3.0
        rig["tau_load"] = 0.2
        assert {name: rig[name] for name in before} == before
        rig.step(1e-3)
        assert rig["omega_m"] < before["omega_m"]


def test_positive_load_costs_droop_times_torque_of_positive_speed(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5) as rig:
        rig.run(1e-3, 600)
        free = rig["omega_m"]
        rig["tau_load"] = 0.1
        rig.run(1e-3, 600)
        # the ripple of pmsm_foc's encoder; the other two are exact to rounding
        assert free - rig["omega_m"] == pytest.approx(DROOP[drive] * 0.1, abs=5e-4)


def test_a_sudden_load_never_speeds_the_shaft_up(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5) as rig, Rig(drive).start(omega_ref=0.5) as free:
        for instance in (rig, free):
            instance.run(1e-3, 300)
        rig["tau_load"] = 0.1
        for _ in range(10):
            for instance in (rig, free):
                instance.step(1e-3)
            assert rig["omega_m"] <= free["omega_m"]
            assert rig["theta_m"] <= free["theta_m"]


def test_instances_do_not_share_memory(drive: str) -> None:
    with Rig(drive).start() as alone:
        alone["omega_ref"] = 0.4
        alone.run(1e-3, 30)
        expected = alone.values()
    with Rig(drive).start() as one, Rig(drive).start() as two, Rig(drive).start() as three:
        for instance, omega_ref in ((one, 0.4), (two, -7.0), (three, 2.0)):
            instance["omega_ref"] = omega_ref
        for _ in range(30):
            for instance in (one, two, three):
                instance.step(1e-3)
        assert one.values() == expected
