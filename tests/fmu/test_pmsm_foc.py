"""pmsm_foc.fmu: its README's equations, the design values of its loops, its limits."""

import numpy as np
import pytest

from .pmsm_equations import Pmsm
from .rig import Rig

DRIVE = "pmsm_foc"
PMSM = Pmsm()


# An encoder without steps and no bend in the friction leave the Runge-Kutta error alone: a real count can
# fall one tick early or late for an error of 1e-10 rad, which then shows as 6e-6 rad.
SMOOTH = {"counts": 2.0**44, "tau_c": 0.0}


@pytest.mark.parametrize(
    ("omega_ref", "tau_load", "parameters", "error"),
    [
        # (T_c R/L)^5 / 120 = 3e-9 of the currents in every tick, k_t/J_m = 1000 times that in speed within a
        # loop's 4 ms; in the first case the bend of the friction, at the voltage circle speeds of 200 rad/s
        pytest.param(0.3, 0.05, {}, 2e-7, id="the robot's speeds"),
        pytest.param(60.0, -0.1, SMOOTH, 1e-6, id="current limit"),
        pytest.param(400.0, 0.0, SMOOTH, 1e-6, id="voltage circle"),
    ],
)
def test_drive_follows_its_equations(
    omega_ref: float, tau_load: float, parameters: dict[str, float], error: float
) -> None:
    reference = Pmsm(**parameters)
    with Rig(DRIVE).start(omega_ref=omega_ref, **parameters) as drive:
        for load in (0.0, tau_load):
            drive["tau_load"] = load
            for _ in range(50):
                reference.run(omega_ref, load, ticks=6)
                drive.step(6 * PMSM.T_c)
                expected = dict(zip(("i_d", "current", "omega_m", "theta_m"), reference.x, strict=True))
                expected |= {name: getattr(reference, name) for name in ("v_q", "omega_obs", "x_v", "x_q")}
                for name, value in expected.items():
                    assert drive[name] == pytest.approx(value, rel=0, abs=error), name


def test_torque_is_proportional_to_the_quadrature_current() -> None:
    with Rig(DRIVE).start(omega_ref=5.0, tau_load=0.2) as drive:
        for _ in range(50):
            drive.step(1e-3)
            assert drive["tau_motor"] == pytest.approx(1.5 * 7 * 0.01 * drive["current"], rel=1e-15)


def test_steady_torque_carries_load_and_friction() -> None:
    with Rig(DRIVE).start(omega_ref=0.5, tau_load=0.1) as drive:
        drive.run(1e-3, 500)
        friction = PMSM.b_m * 0.5 + PMSM.tau_c * 0.5 / np.hypot(0.5, PMSM.omega_c)
        # encoder ripple: some 4e-5 A
        assert drive["tau_motor"] == pytest.approx(0.1 + friction, abs=2e-5)


def test_current_follows_its_reference_with_the_designed_bandwidth() -> None:
    # a rotor that cannot move, and a velocity gain that asks for 1 A at once
    locked = {"J_m": 1e3, "omega_v": PMSM.k_t / 1e3}
    with Rig(DRIVE).start(omega_ref=1.0, **locked) as drive:
        for tick in range(1, 40):
            drive.step(PMSM.T_c)
            designed = 1.0 - np.exp(-PMSM.omega_i * tick * PMSM.T_c)
            # the reference itself drifts by the rotor's creep of 1e-7 rad/s
            assert drive["current"] == pytest.approx(designed, abs=1e-6)


def test_decoupling_keeps_the_field_current_small_at_speed() -> None:
    with Rig(DRIVE).start(omega_ref=100.0) as drive:
        drive.run(1e-3, 300)
        drive["tau_load"] = 0.2
        drive.run(1e-3, 20)
        # without decoupling omega_e L i_q = 0.7 V would stand against kp_i = 2.8 V/A: 0.25 A
        assert abs(drive["i_d"]) < 0.01
        assert drive["current"] > 1.5


def gain(frequency: float) -> float:
    """|omega_m / omega_ref| for a small sine around 0.5 rad/s, where friction does not change sign."""
    h, amplitude = 2e-4, 0.2
    time, speed = [], []
    with Rig(DRIVE).start(omega_ref=0.5) as drive:
        for _ in range(round((0.2 + 4 / frequency) / h)):
            drive["omega_ref"] = 0.5 + amplitude * np.sin(2 * np.pi * frequency * drive.time)
            drive.step(h)
            time.append(drive.time)
            speed.append(drive["omega_m"] - 0.5)
    last = np.array(time) > time[-1] - 4 / frequency
    phasor = np.exp(-2j * np.pi * frequency * np.array(time)[last])
    return float(2 * abs(np.mean(np.array(speed)[last] * phasor))) / amplitude


def test_velocity_bandwidth_lies_where_the_design_puts_it() -> None:
    # crossover at 40 Hz with an integral of a quarter of it: flat to 40 Hz, -3 dB below twice the crossover
    assert gain(4.0) == pytest.approx(1.0, abs=0.06)
    assert gain(40.0) > np.sqrt(0.5)
    assert gain(80.0) < np.sqrt(0.5)


def test_speed_step_overshoots_no_more_than_a_fifth_and_settles() -> None:
    with Rig(DRIVE).start(omega_ref=2.0) as drive:
        speeds = []
        for _ in range(150):
            drive.step(1e-3)
            speeds.append(drive["omega_m"])
    assert max(speeds) < 1.2 * 2.0
    # what the integral leaves, e^-6 of the step, and encoder ripple
    assert speeds[-50:] == pytest.approx([2.0] * 50, abs=5e-3)


@pytest.mark.parametrize("tau_load", [-0.1, 0.1, 0.4])
def test_load_leaves_no_steady_speed_error(tau_load: float) -> None:
    with Rig(DRIVE).start(omega_ref=0.2, tau_load=tau_load) as drive:
        drive.run(1e-3, 500)
        begin = drive["theta_m"]
        drive.run(1e-3, 500)
        # mean over 0.5 s, so that encoder ripple does not count
        assert (drive["theta_m"] - begin) / 0.5 == pytest.approx(0.2, abs=2e-6)


def test_a_load_step_costs_the_angle_of_the_integral() -> None:
    with Rig(DRIVE).start(omega_ref=0.2) as drive:
        drive.run(1e-3, 400)
        begin = drive["theta_m"]
        drive["tau_load"] = 0.1
        drive.run(1e-3, 500)
        lost = 0.2 * 0.5 - (drive["theta_m"] - begin)
        # equation (15); encoder ripple and what is left of the friction's bend
        assert lost == pytest.approx(4 * 0.1 / (PMSM.J_m * PMSM.omega_v**2), rel=2e-3)


@pytest.mark.parametrize("omega_ref", [0.01, 0.05, 0.2, 0.5])
def test_slow_rotation_is_smooth(omega_ref: float) -> None:
    with Rig(DRIVE).start(omega_ref=omega_ref, tau_load=0.05) as drive:
        drive.run(1e-3, 500)
        speeds = []
        for _ in range(1000):
            drive.step(2e-4)
            speeds.append(drive["omega_m"])
    # an encoder count is 6e-6 rad; the loop turns it into 2e-5 to 5e-5 rad/s of ripple
    assert np.std(speeds) < 1e-4
    assert np.mean(speeds) == pytest.approx(omega_ref, abs=1e-5)


def test_speed_ends_at_the_voltage_circle() -> None:
    with Rig(DRIVE).start(omega_ref=400.0) as drive:
        drive.run(1e-3, 500)
        v_max = PMSM.V_bus / np.sqrt(3)
        assert np.hypot(drive["v_d"], drive["v_q"]) == pytest.approx(v_max, rel=1e-14)  # rounding
        # (1), (2) at rest: the magnets' voltage takes what resistance and field current leave
        omega_e = PMSM.p * drive["omega_m"]
        v_q = PMSM.R * drive["current"] + omega_e * (PMSM.L * drive["i_d"] + PMSM.psi)
        assert drive["v_q"] == pytest.approx(v_q, rel=1e-6)  # the last of the transient
        assert drive["omega_m"] < v_max / (PMSM.p * PMSM.psi)


def test_current_and_torque_stay_within_the_limit() -> None:
    with Rig(DRIVE).start(omega_ref=50.0) as drive:
        for _ in range(400):
            drive.step(PMSM.T_c)
            assert abs(drive["i_q_ref"]) <= PMSM.i_max
            assert drive["current"] < 1.001 * PMSM.i_max  # back-EMF grows within a tick
        drive["omega_ref"] = -50.0
        drive.run(1e-3, 3)
        assert drive["current"] == pytest.approx(-PMSM.i_max, rel=1e-2)  # the observer lags the braking rotor


def test_load_above_the_torque_limit_drags_the_shaft_backwards() -> None:
    with Rig(DRIVE).start(omega_ref=0.5, tau_load=0.65) as drive:
        drive.run(1e-3, 100)
        assert drive["omega_m"] < -10.0
        assert drive["tau_motor"] == pytest.approx(PMSM.k_t * PMSM.i_max, rel=1e-6)


def test_integrals_stop_at_the_limits_and_let_go_at_once() -> None:
    with Rig(DRIVE).start(omega_ref=400.0) as drive:
        drive.run(1e-3, 2000)
        # rounding; a free integral would stand at ki_v * 200 rad/s * 2 s = 6000 A
        assert abs(drive["x_v"]) <= PMSM.i_max * (1 + 1e-12)
        assert np.hypot(drive["x_d"], drive["x_q"]) <= PMSM.V_bus / np.sqrt(3) * (1 + 1e-12)
        drive["omega_ref"] = 0.5
        drive.run(1e-3, 300)
        assert drive["omega_m"] == pytest.approx(0.5, abs=1e-3)  # e^-6 of the last overshoot


@pytest.mark.parametrize("h", [PMSM.T_c, 0.25e-3, 0.5e-3])
def test_steps_of_whole_ticks_change_nothing(h: float) -> None:
    start = {"omega_ref": 0.5, "tau_load": 0.1}
    with Rig(DRIVE).start(**start) as whole, Rig(DRIVE).start(**start) as split:
        whole.run(1e-3, 50)
        split.run(h, round(0.05 / h))
        assert split["theta_m"] == pytest.approx(whole["theta_m"], rel=1e-12)  # rounding of the tick clock
        assert split["omega_m"] == pytest.approx(whole["omega_m"], rel=1e-10)


@pytest.mark.parametrize("h", [7e-6, 33e-6, 0.13e-3, 1e-3 / 3])
def test_steps_that_cut_ticks_change_nothing_but_integration_error(h: float) -> None:
    steps = round(0.02 / h)
    start = {"omega_ref": 0.5, "tau_load": 0.1, **SMOOTH}
    with Rig(DRIVE).start(**start) as whole, Rig(DRIVE).start(**start) as cut:
        whole.step(steps * h)
        cut.run(h, steps)
        assert cut["theta_m"] == pytest.approx(whole["theta_m"], abs=1e-9)  # the Runge-Kutta error of a tick
        assert cut["until_tick"] == pytest.approx(whole["until_tick"], abs=1e-15)


@pytest.mark.parametrize("deviation", [-5e-7, 5e-7])
def test_nearly_whole_ticks_do_not_make_the_clock_drift(deviation: float) -> None:
    # below what counts as rounding, 1e-6 of a tick: the surplus must add up all the same
    with Rig(DRIVE).start() as drive:
        drive.run(PMSM.T_c * (1 + deviation), 2000)
        expected = -2000 * deviation * PMSM.T_c % PMSM.T_c
        assert drive["until_tick"] == pytest.approx(expected, abs=1e-15)  # 4000 roundings of 1e-20 s


def test_voltage_changes_only_at_the_controllers_ticks() -> None:
    with Rig(DRIVE).start(omega_ref=0.5) as drive:
        changes = []
        for step in range(100):
            before = drive["v_q"]
            drive.step(10e-6)
            if drive["v_q"] != before:
                changes.append(step)
    assert changes == list(range(0, 100, 5))


def test_three_drives_on_springs_hold_their_positions() -> None:
    # the robot's use: links held still, each spring loads its motor, a slow loop commands every other step
    k_s, kp = 1.0, 1.5
    targets = (0.1, -0.05, 0.02)
    drives = [Rig(DRIVE).start() for _ in targets]
    for tick in range(5000):
        for drive, target in zip(drives, targets, strict=True):
            if tick % 2 == 0:
                drive["omega_ref"] = float(np.clip(kp * (target - drive["theta_m"]), -0.5, 0.5))
            drive["tau_load"] = k_s * drive["theta_m"]
            drive.step(1e-3)
    for drive, target in zip(drives, targets, strict=True):
        # after 5 s of a loop with kp = 1.5 1/s, slowed by the drive's give under load: e^-4.6 is left
        assert drive["theta_m"] == pytest.approx(target, rel=0.02)
        assert abs(drive["omega_m"]) < 0.01
        drive.slave.freeInstance()
