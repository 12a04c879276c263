"""From an experiment to components and wires: the only place where the parts meet."""

from twin.assembly.computer import belief, controller
from twin.assembly.robot import Assembly, assemble

__all__ = ["Assembly", "assemble", "belief", "controller"]
