"""FMPy's slaves in a loop of some lines: what a master does, with nothing that could be its own."""

from collections.abc import Callable

from tests.studies.build.slaves import Slave
from validation.masters.robot import Robot, Rows, Signals


def looped(robot: Robot, time_of: Callable[[int], float]) -> Signals:
    """A run in which all exchange their values between steps.

    Args:
        robot: what is run.
        time_of: of the instant between the steps k - 1 and k (s); a step is as long as the difference of two.
    """
    slaves = {name: Slave(file, robot.parameters.get(name, {})).ready() for name, file in robot.files.items()}
    sources = [(slaves[w.source[0]], slaves[w.source[0]].references(w.source[1]), w.offset) for w in robot.wires]
    targets = [(slaves[w.target[0]], slaves[w.target[0]].references(w.target[1])) for w in robot.wires]
    outputs = {name: [slaves[name].variables[v].valueReference for v in robot.outputs[name]] for name in slaves}
    rows = Rows(robot)
    for k in range(robot.ticks):
        t = time_of(k)
        values = [slave.take(references)[0] + offset for slave, references, offset in sources]
        for (slave, references), value in zip(targets, values, strict=True):
            slave.put(references, [value])
        for name, slave in slaves.items():
            slave.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=time_of(k + 1) - t)
            rows.values[name][k + 1] = slave.take(outputs[name])
    for slave in slaves.values():
        slave.close()
    return rows.signals()
