"""A drive that cannot run as fast as it is told: the command is limited on its last way into the drive."""

from twin.compiled.function import carray
from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port
from twin.cosim.record import memory_of, record
from twin.faults.window import ACTIVE, WINDOW, Span, tick_now, window, within

MEMORY = record(window=WINDOW, size="i8", limit="f8")


@step_function(MEMORY)
def step(m, t, h, u, y):
    asked, given = carray(u, m.size), carray(y, m.size + 1)
    active = within(m.window, tick_now(m.window))
    for j in range(m.size):
        given[j] = min(max(asked[j], -m.limit), m.limit) if active else asked[j]
    given[m.size] = active
    return 0


class CommandFault(NativeComponent):
    """Sampled component, every tick: commanded speeds in, the same within +-limit out while active.

    Args:
        name: of the component.
        span: when it is active.
        limit: of the drives' speed (rad/s).
        size: number of drives behind it.
    """

    def __init__(self, name: str, span: Span, limit: float, size: int):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, as far as the drive can follow")
        memory = memory_of(MEMORY, window=window(span, 1), size=size, limit=limit)
        super().__init__(name, (port,), (port, ACTIVE), True, step, memory)
