"""What every drive promises to the robot, whatever is inside it; names and units only of those without a mapping."""

import pytest

from .rig import DRIVES, MIDDLING, Rig, described, mapping

CONTRACT = {
    "omega_ref": ("input", "rad/s"),
    "tau_load": ("input", "N.m"),
    "theta_m": ("output", "rad"),
    "omega_m": ("output", "rad/s"),
}
OPTIONAL = {"tau_motor": ("output", "N.m"), "current": ("output", "A"), "status": ("output", "1")}
SPEAKING_IT = [drive for drive in DRIVES if not mapping(drive)]

# steady loss of speed per torque of load, rad/(s N m)
DROOP = {"ideal_velocity": 0.0, "pmsm_foc": 0.0, "stepper": 0.0, "velocity_servo": 0.6}

# on the magnetic spring between field and rotor the speed swings about its mean, the angle stays behind
SWINGING = {"stepper"}

of_every_drive = pytest.mark.parametrize("drive", DRIVES)
of_drives_speaking_it = pytest.mark.parametrize("drive", SPEAKING_IT)


@of_drives_speaking_it
def test_ports_have_the_contract_names_causalities_and_units(drive: str) -> None:
    ports = {
        v.name: (v.causality, v.unit) for v in described(drive).modelVariables if v.causality in ("input", "output")
    }
    assert ports.items() >= CONTRACT.items()
    assert ports.items() <= (CONTRACT | OPTIONAL).items()


@of_drives_speaking_it
def test_outputs_start_at_zero(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5, tau_load=0.1) as rig:
        for variable in described(drive).modelVariables:
            if variable.causality == "output":
                assert rig[variable.name] == 0.0


@of_every_drive
def test_inputs_move_outputs_only_through_a_step(drive: str) -> None:
    with Rig(drive).start(command=MIDDLING.get(drive, 0.5)) as rig:
        rig.run(1e-3, 5)
        before = {name: rig[name] for name in CONTRACT if name.endswith("_m")}
        rig["command"] = -6 * MIDDLING.get(drive, 0.5)
        rig["tau_load"] = 0.2
        assert {name: rig[name] for name in before} == before
        rig.step(1e-3)
        assert rig["omega_m"] < before["omega_m"]


def mean_speed(rig: Rig) -> float:
    """Over 600 ms, after as long to settle."""
    rig.run(1e-3, 600)
    begin = rig["theta_m"]
    rig.run(1e-3, 600)
    return (rig["theta_m"] - begin) / 0.6


@of_drives_speaking_it
def test_positive_load_costs_droop_times_torque_of_positive_speed(drive: str) -> None:
    with Rig(drive).start(omega_ref=0.5) as rig:
        free = mean_speed(rig)
        rig["tau_load"] = 0.1
        # a micro-step of stepper in 0.6 s; the others are exact to their encoder's ripple or to rounding
        assert free - mean_speed(rig) == pytest.approx(DROOP[drive] * 0.1, abs=2e-3)


@of_every_drive
def test_a_sudden_load_never_speeds_the_shaft_up(drive: str) -> None:
    start = {"command": MIDDLING.get(drive, 0.5)}
    with Rig(drive).start(**start) as rig, Rig(drive).start(**start) as free:
        for instance in (rig, free):
            instance.run(1e-3, 300)
        rig["tau_load"] = 0.1
        for _ in range(10):
            for instance in (rig, free):
                instance.step(1e-3)
            assert rig["omega_m"] <= free["omega_m"] or drive in SWINGING
            assert rig["theta_m"] <= free["theta_m"]


@of_every_drive
def test_instances_do_not_share_memory(drive: str) -> None:
    with Rig(drive).start() as alone:
        alone["command"] = 0.4
        alone.run(1e-3, 30)
        expected = alone.values()
    with Rig(drive).start() as one, Rig(drive).start() as two, Rig(drive).start() as three:
        for instance, command in ((one, 0.4), (two, -7.0), (three, 2.0)):
            instance["command"] = command
        for _ in range(30):
            for instance in (one, two, three):
                instance.step(1e-3)
        assert one.values() == expected
