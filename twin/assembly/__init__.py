"""From an experiment to components and wires: the only place where the parts meet."""

from twin.assembly.assemble import Assembly, assemble
from twin.assembly.computer import belief, controller

__all__ = ["Assembly", "assemble", "belief", "controller"]
