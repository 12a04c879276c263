"""The engine's robot as the plant of the twin: its bodies and joint friction, our springs, our contact."""

from typing import Any

import numpy as np

from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.port import Port, memory_of
from twin.kernel.cosim.python_class import PythonComponent
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.statics import motor_load_torque
from twin.robot.plant.component import NO_MOTION, PLANT_OUTPUTS, plant_inputs, rest_state, settle
from twin.robot.plant.contact import apex_frame, touch
from twin.robot.plant.dynamics import PARAMETERS_RECORD, PlantParameters, spring_deflection, spring_stiffness
from twin.robot.run.trace import Trace
from validation.engine.constrained import Constrained, Numbers
from validation.engine.mechanism import Mechanism
from validation.engine.robots import spring_torques


class EnginesPlant:
    """What `PythonComponent` steps: one step of Runge-Kutta as in the twin's own plant, friction settled after it.

    So the robot differs and not how it is integrated. Rods begin without turning about their own axis, and go on so:
    they are round, and held by balls at both ends.

    Args:
        mechanism: the bodies.
        parameters: of springs and contact.
        x, theta_m: state (8,) and motor angles (3,) to begin with.
    """

    inputs: tuple[Port, ...] = plant_inputs(moving=False, ramp=False)
    outputs: tuple[Port, ...] = PLANT_OUTPUTS
    sampled = False

    def __init__(self, mechanism: Mechanism, parameters: PlantParameters, x: Numbers, theta_m: Numbers):
        self._mechanism, self._x = mechanism, x.copy()
        self._parameters = parameters
        # a record is handed to compiled code faster than a tuple, but has no attributes in Python
        self._record: Any = memory_of(PARAMETERS_RECORD, **parameters._asdict())[0]
        self._apex = apex_frame(parameters)
        self.first = np.concatenate(self._answer(theta_m))

    def step(self, t: float, h: float, u: Numbers, y: Numbers) -> None:
        """One step of `h` seconds, see `PythonModel`."""
        theta_m, x = u.copy(), self._x
        # where it stands the last answer was given
        k_1 = self._rate(x, theta_m, self._bodies)
        k_2 = self._moved(x + 0.5 * h * k_1, theta_m)
        k_3 = self._moved(x + 0.5 * h * k_2, theta_m)
        k_4 = self._moved(x + h * k_3, theta_m)
        x += h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        settle.dispatcher(self._record, self._apex, x, NO_MOTION, NO_MOTION)
        y[:] = np.concatenate(self._answer(theta_m))

    def _moved(self, x: Numbers, theta_m: Numbers) -> Numbers:
        return self._rate(x, theta_m, self._at(x))

    def _at(self, x: Numbers) -> Constrained:
        self._mechanism.move(x[:3])
        return self._mechanism.equations(x[3:6])

    def _rate(self, x: Numbers, theta_m: Numbers, bodies: Constrained) -> Numbers:
        """dx/dt of the state `x` (8,), in which the mechanism is."""
        mechanism = self._mechanism
        contact = touch.dispatcher(self._record, self._apex, *x)
        forces = mechanism.on_arms(spring_torques(self._parameters, theta_m, mechanism.theta_l, mechanism.omega_l))
        forces[mechanism.platform] = [-force for force in contact[:3]]
        return np.concatenate([x[3:6], bodies.acceleration(forces)[mechanism.platform], contact[4:]])

    def _answer(self, theta_m: Numbers) -> tuple[Any, ...]:
        """Values of `PLANT_OUTPUTS`."""
        mechanism, c, x = self._mechanism, self._parameters, self._x
        self._bodies = self._at(x)
        theta_l, omega_l = mechanism.theta_l, mechanism.omega_l
        load = [
            motor_load_torque(spring_stiffness(c, leg), spring_deflection(c, leg, theta_m[leg], theta_l[leg]))
            for leg in range(3)
        ]
        contact = touch.dispatcher(self._record, self._apex, *x)
        tau_l = spring_torques(c, theta_m, theta_l, omega_l)
        return x[:3], x[3:6], theta_l, omega_l, tau_l, load, contact[:3], contact[3:4], x[6:]


def run(experiment: Experiment) -> Trace:
    """The run of an experiment on the scale, with the engine's robot for a plant."""
    parameters = plant_parameters(experiment.plant, experiment.contact)
    x, theta_m = rest_state(parameters, experiment.start)
    plant = EnginesPlant(Mechanism(parameters), parameters, x, theta_m)
    trace = Trace()
    with assemble(
        experiment, {"plant": PythonComponent("plant", plant, initial_outputs=plant.first.tolist())}
    ) as assembly:
        simulate(assembly, experiment.duration_ticks, [trace]).require_success()
    return trace
