"""A velocity servo whose firmware is Python: sampled PI with friction feed-forward and a slew-limited torque.

Equations (1) to (8) of README.md. pythonfmu turns this file into python_servo.fmu; inside the FMU it runs in the
interpreter of the process that loads it.
"""

from math import inf, isfinite, tanh

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

INPUTS = {
    "omega_ref": "Commanded motor speed, held over a step (rad/s)",
    "tau_load": "Torque the spring asks of the motor shaft, held over a step; positive opposes positive omega_m (N m)",
}
OUTPUTS = {
    "theta_m": "Motor angle, before spring and belt (rad)",
    "omega_m": "Motor speed (rad/s)",
    "tau_motor": "Torque the machine produces, before its friction (N m)",
}
PARAMETERS = {
    "J_m": "Inertia of rotor, coupling and spring hub (kg m2)",
    "b_m": "Viscous friction (N m s/rad)",
    "tau_c": "Coulomb friction (N m)",
    "omega_c": "Speed over which the Coulomb friction changes sign (rad/s)",
    "phi": "Share of the friction that the firmware feeds forward (1)",
    "kp": "Proportional gain (N m s/rad)",
    "ki": "Integral gain (N m/rad)",
    "tau_max": "Torque limit (N m)",
    "slew": "Largest change of torque per time (N m/s)",
    "T_c": "Period of the firmware (s)",
}
LOCALS = {
    "x": "Integral of the firmware's PI (N m)",
    "until_tick": "Time until the firmware's next tick (s)",
}


class PythonServo(Fmi2Slave):
    """The servo. pythonfmu reads and sets its public attributes by the names registered in the constructor."""

    description = "Velocity servo in Python: sampled PI, friction feed-forward, slew-limited torque"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.modelName = "python_servo"
        self.omega_ref = self.tau_load = 0.0
        self.theta_m = self.omega_m = self.tau_motor = 0.0
        self.x = self.until_tick = 0.0
        self.J_m, self.b_m, self.tau_c, self.omega_c = 1e-4, 1e-4, 0.004, 0.1
        self.phi, self.kp, self.ki = 0.8, 0.025, 1.56
        self.tau_max, self.slew, self.T_c = 0.6, 50.0, 1e-3
        groups = (
            (INPUTS, Fmi2Causality.input, Fmi2Variability.continuous, None),
            (OUTPUTS, Fmi2Causality.output, Fmi2Variability.continuous, Fmi2Initial.exact),
            (PARAMETERS, Fmi2Causality.parameter, Fmi2Variability.fixed, Fmi2Initial.exact),
            # registered so that a saved state holds them too
            (LOCALS, Fmi2Causality.local, Fmi2Variability.continuous, Fmi2Initial.exact),
        )
        for names, causality, variability, initial in groups:
            for name, meaning in names.items():
                self.register_variable(
                    Real(name, causality=causality, variability=variability, initial=initial, description=meaning)
                )

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by `step_size` seconds (8).

        Returns:
            False, which the wrapper reports as fmi2Discard, for a step that would never end and for a result that is
            not finite.
        """
        if not (0.0 < step_size < inf and self.T_c > 0.0):
            return False
        left = step_size
        rounding = 1e-6 * self.T_c
        while left > 0.0:
            if self.until_tick <= 0.0:
                self.control()
                self.until_tick += self.T_c
            dt = self.until_tick if self.until_tick < left - rounding else left
            self.move(dt)
            self.until_tick -= dt
            left -= dt
        return isfinite(self.theta_m)

    def control(self) -> None:
        """One tick of the firmware: (1) to (5)."""
        error = self.omega_ref - self.omega_m
        wanted = self.phi * self.friction(self.omega_ref) + self.kp * error + self.x
        reach = self.slew * self.T_c
        slewed = min(max(wanted, self.tau_motor - reach), self.tau_motor + reach)
        self.tau_motor = min(max(slewed, -self.tau_max), self.tau_max)
        self.x += self.ki * self.T_c * (error + (self.tau_motor - wanted) / self.kp)

    def friction(self, omega: float) -> float:
        """Friction torque at speed `omega`, (6)."""
        return self.b_m * omega + self.tau_c * tanh(omega / self.omega_c)

    def acceleration(self, omega: float) -> float:
        """(7)"""
        return (self.tau_motor - self.tau_load - self.friction(omega)) / self.J_m

    def move(self, dt: float) -> None:
        """One classical Runge-Kutta step of order 4 of (7) over `dt` <= T_c with the torques held."""
        omega = self.omega_m
        k_1 = self.acceleration(omega)
        k_2 = self.acceleration(omega + 0.5 * dt * k_1)
        k_3 = self.acceleration(omega + 0.5 * dt * k_2)
        k_4 = self.acceleration(omega + dt * k_3)
        # the shaft's rate is omega itself: its four slopes are omega at the points where k_1 to k_4 were taken
        self.theta_m += dt * (omega + dt / 6.0 * (k_1 + k_2 + k_3))
        self.omega_m += dt / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
