"""FMPy's slaves in a loop of some lines: what a master does, with nothing that could be its own."""

from collections.abc import Callable

import numpy as np

from tests.studies.build.slaves import Ends, Slave
from validation.masters.robot import Robot, Rows, Signals


def looped(robot: Robot, time_of: Callable[[int], float]) -> Signals:
    """A run in which all exchange their values between steps.

    Args:
        robot: what is run.
        time_of: of the instant between the steps k - 1 and k (s); a step is as long as the difference of two.
    """
    slaves = {name: Slave(file, robot.parameters.get(name, {})).ready() for name, file in robot.files.items()}
    outputs = {
        name: Ends(slave, [slave.variables[output].valueReference for output in robot.outputs[name]])
        for name, slave in slaves.items()
    }
    wires = {name: [wire for wire in robot.wires if wire.target[0] == name] for name in slaves}
    inputs = {
        name: Ends(slave, [slave.variables[wire.target[1]].valueReference for wire in wires[name]])
        for name, slave in slaves.items()
    }
    sources = {
        name: [
            (outputs[c].values, robot.outputs[c].index(output), w.offset)
            for w in wires[name]
            for c, output in [w.source]
        ]
        for name in slaves
    }
    rows = Rows(robot)
    for end in outputs.values():
        end.take()
    for k in range(robot.ticks):
        t = time_of(k)
        for name, end in inputs.items():
            end.put(np.array([values[i] + offset for values, i, offset in sources[name]]))
        for name, slave in slaves.items():
            slave.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=time_of(k + 1) - t)
            rows.values[name][k + 1] = outputs[name].take()
    for slave in slaves.values():
        slave.close()
    return rows.signals()
