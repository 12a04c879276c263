"""Which FMI function a component's step ends up in, for sentences about steps that do not end."""

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.subsystem import Subsystem
from twin.kernel.fmi.component import FmuComponent


class Elsewhere(Component):
    """A component that stands for one in another process.

    Attributes:
        function: what `called_function` says of that one.
    """

    function: str


def called_function(component: Component) -> str:
    """The FMI function that a step of `component` calls, empty if it calls none."""
    if isinstance(component, FmuComponent):
        return component.called
    if isinstance(component, Subsystem):
        return ", ".join(dict.fromkeys(filter(None, map(called_function, component.system.components))))
    return component.function if isinstance(component, Elsewhere) else ""
