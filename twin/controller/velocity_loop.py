"""Our velocity loop for drives that take torque, current or voltage: a discrete PI at its own rate."""

from twin.controller.pid import PID, Gains, accept, loop, proposal
from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port
from twin.cosim.record import memory_of, record

INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("omega_m", 1, "rad/s", "motor speed, as the drive reports it"),
)
COMMAND = Port("command", 1, "SI", "what the drive takes: torque, current or voltage")
MEMORY = record(pid=PID, limit="f8")


@step_function(MEMORY, INPUTS, (COMMAND,))
def step(m, t, h, u, y):
    command, integral = proposal(m.pid, u.omega_ref - u.omega_m, h)
    if abs(command) <= m.limit:
        accept(m.pid, integral)
    y.command = min(max(command, -m.limit), m.limit)
    return 0


class DriveSpeedLoop(NativeComponent):
    """Sampled component: speed error in, command of the drive out.

    Args:
        gains: PI from rad/s to the command's SI unit.
        limit: of the command, either side.
        command: port of the output.
        period: in ticks of the drive's own system.
    """

    def __init__(self, gains: Gains, limit: float, command: Port, period: int = 1):
        memory = memory_of(MEMORY, pid=loop(gains), limit=limit)
        super().__init__("velocity_loop", INPUTS, (command,), True, step, memory, period=period)
