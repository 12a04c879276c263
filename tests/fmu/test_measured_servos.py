"""xl330.fmu and mx106.fmu: the published equations of their identification by scipy, and by the published scheme."""

import json
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from .rig import FMUS, Rig

SERVOS = ("xl330", "mx106")
of_every_servo = pytest.mark.parametrize("drive", SERVOS)
MODELS = ("m1", "m2", "m3", "m4", "m5", "m6")


def parameters(drive: str, model: str = "m6") -> dict[str, float]:
    """What drive.toml says of it, and the mapping of another friction model over that."""
    said: dict[str, float] = tomllib.loads((FMUS / drive / "drive.toml").read_text())["start"]
    other = {} if model == "m6" else tomllib.loads((FMUS / drive / f"{model}.toml").read_text())["parameters"]
    return said | other


@dataclass
class Servo:
    """Numbers in brackets: the equations of fmus/measured_servo/README.md."""

    p: dict[str, float]
    voltage: float = 0.0
    load: float = 0.0
    theta: float = 0.0
    omega: float = 0.0

    def control(self, goal: float) -> None:
        """(1)"""
        p = self.p
        share = p["k_p"] * p["error_gain"] * (goal - self.theta)
        self.voltage = p["v_in"] * min(max(share, -p["pwm_max"]), p["pwm_max"])

    def motor(self, omega: float) -> float:
        """(3)"""
        return self.p["k_t"] / self.p["R"] * (self.voltage - self.p["k_t"] * omega)

    def friction(self, omega: float) -> float:
        """(4), (5)"""
        p, motor, external = self.p, self.motor(omega), -self.load
        s = math.exp(-((abs(omega) / p["omega_s"]) ** p["alpha"]))
        running = p["friction_base"] + abs(p["load_external"] * external - p["load_motor"] * motor)
        sticking = p["friction_stribeck"]
        sticking += abs(p["load_external_stribeck"] * external - p["load_motor_stribeck"] * motor)
        if np.sign(external) != np.sign(motor):
            sticking += p["load_external_quad"] * external**2 * (abs(external) < abs(motor))
            sticking += p["load_motor_quad"] * motor**2 * (abs(external) > abs(motor))
        return running + s * sticking

    def fly(self, h: float) -> None:
        """(6), (7) for `h` seconds by scipy, from rest to rest."""
        t = 0.0
        while t < h:
            net = self.motor(0.0) - self.load
            if self.omega == 0.0 and abs(net) <= self.friction(0.0):
                return
            way = math.copysign(1.0, self.omega or net)

            def rates(_: float, x: np.ndarray, way: float = way) -> list[float]:
                resisting = self.friction(x[1]) + self.p["friction_viscous"] * way * x[1]
                return [x[1], (self.motor(x[1]) - self.load - way * resisting) / self.p["J"]]

            def stops(_: float, x: np.ndarray, way: float = way) -> float:
                return float(way * x[1])

            stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
            run: Any = solve_ivp(
                rates, (t, h), [self.theta, self.omega], "DOP853", events=stops, rtol=1e-11, atol=1e-13
            )
            t = run.t[-1]
            self.theta, self.omega = run.y[0, -1], 0.0 if run.status == 1 else run.y[1, -1]


@pytest.mark.parametrize("model", MODELS)
@of_every_servo
def test_the_drive_follows_the_published_equations(drive: str, model: str) -> None:
    p = parameters(drive, model)
    servo = Servo(p)
    # each way, under loads that drive and resist, to standstill and off again
    held = [(0.3, 0.0), (0.3, 0.15), (-0.2, 0.15), (-0.2, 0.15), (-0.2, 0.0), (-0.2, -0.3), (-0.19, -0.3), (0.0, 0.4)]
    with Rig(drive).start(**p) as rig:
        for goal, load in held:
            rig["goal_position"] = goal
            rig["tau_load"] = servo.load = load * (10.0 if drive == "mx106" else 1.0)
            for _ in range(60):
                servo.control(goal)
                servo.fly(1e-3)
                rig.step(1e-3)
                # Runge-Kutta over kinks: friction has them where the load takes over from the motor, M4 at rest as well
                assert rig["theta_m"] == pytest.approx(servo.theta, rel=0, abs=3e-8)
                assert rig["omega_m"] == pytest.approx(servo.omega, rel=0, abs=3e-6)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(goal=st.floats(-0.5, 0.5), load=st.floats(-1.0, 1.0), speed=st.floats(-5.0, 5.0))
@of_every_servo
def test_the_published_scheme_converges_to_the_drive(drive: str, goal: float, load: float, speed: float) -> None:
    """Euler's step with the torque that would stop the shaft as a bound of friction, ten times finer."""
    p = parameters(drive)
    load *= 6.0 if drive == "mx106" else 0.5
    with Rig(drive).start(goal_position=goal, tau_load=load, omega_m=speed, **p) as rig:
        rig.run(1e-3, 20)
        exact = rig["theta_m"]
    error = []
    for dt in (1e-4, 1e-5):
        servo = Servo(p, load=load, omega=speed)
        for _tick in range(20):
            servo.control(goal)
            for _ in range(round(1e-3 / dt)):
                net = servo.motor(servo.omega) - load
                stop = p["J"] / dt * servo.omega + net
                bound = servo.friction(servo.omega) + p["friction_viscous"] * abs(servo.omega)
                alpha = (net - np.sign(stop) * min(abs(stop), bound)) / p["J"]
                servo.omega += alpha * dt
                servo.theta += servo.omega * dt + 0.5 * alpha * dt**2
        error.append(abs(servo.theta - exact))
    # of first order in dt, unevenly where the shaft comes to rest within a step
    assert error[1] < 0.3 * error[0] + 2e-7


def published(drive: str, model: str) -> dict[str, float]:
    """The numbers as they were published, by their own names."""
    table: dict[str, dict[str, dict[str, float]]] = json.loads((FMUS / "measured_servo" / "published.json").read_text())
    return table[drive][model]


@pytest.mark.parametrize("model", MODELS)
@of_every_servo
def test_parameters_are_those_that_were_published(drive: str, model: str) -> None:
    said, p = published(drive, model), parameters(drive, model)
    names = {"kt": "k_t", "R": "R", "armature": "J", "friction_base": "friction_base", "alpha": "alpha"}
    names |= {"friction_stribeck": "friction_stribeck", "friction_viscous": "friction_viscous"}
    names |= {
        f"load_friction_{side}{kind}": f"load_{side}{kind}"
        for side in ("motor", "external")
        for kind in ("", "_stribeck", "_quad")
    }
    names |= {"dtheta_stribeck": "omega_s"}
    used = {name for name in names if name in said}
    assert {names[name]: said[name] for name in used} == {names[name]: p[names[name]] for name in used}
    # without a direction both sides count alike: |a ext - a motor| = a |ext - motor|
    for own, kind in (("load_friction_base", ""), ("load_friction_stribeck", "_stribeck")):
        if own in said:
            assert p[f"load_motor{kind}"] == p[f"load_external{kind}"] == said[own]
            used.add(own)
    assert used == said.keys() - {"q_offset"}
    absent = {names[name] for name in names if name not in said} - {"omega_s", "alpha"}
    if "load_friction_base" in said:
        absent -= {"load_motor", "load_external"}
    if "load_friction_stribeck" in said:
        absent -= {"load_motor_stribeck", "load_external_stribeck"}
    assert not any(p[name] for name in absent)


@of_every_servo
def test_a_speed_moves_the_goal_and_the_shaft_follows_at_that_speed(drive: str) -> None:
    with Rig(drive).start(mode=1.0, theta_m=0.4, **parameters(drive)) as rig:
        rig["goal_velocity"] = 1.0
        rig.run(1e-3, 1500)
        begin = rig["theta_m"]
        rig.run(1e-3, 1000)
        # the last percent of the loop's settling
        assert rig["theta_m"] - begin == pytest.approx(1.0, rel=1e-4)


@of_every_servo
def test_a_blocked_servo_winds_up_no_more_than_its_voltage(drive: str) -> None:
    p = parameters(drive)
    with Rig(drive).start(mode=1.0, tau_load=0.0, **p) as rig:
        rig["goal_velocity"] = 3.0
        rig["tau_load"] = p["k_t"] * p["v_in"] / p["R"]
        rig.run(1e-3, 3000)
        assert abs(rig["goal"] - rig["theta_m"]) <= p["pwm_max"] / (p["k_p"] * p["error_gain"]) + 3.0 * p["T_c"]


def stall(drive: str) -> float:
    """Where full voltage just does not move the shaft, by bisection of the equations at rest."""
    servo = Servo(parameters(drive), voltage=parameters(drive)["v_in"] * parameters(drive)["pwm_max"])
    low, high = 0.0, 100.0
    for _ in range(60):
        servo.load = 0.5 * (low + high)
        moves: Callable[[], bool] = lambda: servo.motor(0.0) - servo.load > servo.friction(0.0)  # noqa: E731
        low, high = (servo.load, high) if moves() else (low, servo.load)
    return low


@of_every_servo
def test_full_voltage_breaks_away_below_the_stall_torque_only(drive: str) -> None:
    most = stall(drive)
    for share, moves in ((0.99, True), (1.01, False)):
        with Rig(drive).start(goal_position=10.0, tau_load=share * most, **parameters(drive)) as rig:
            rig.run(1e-3, 20)
            assert (rig["theta_m"] > 0.0) is moves
