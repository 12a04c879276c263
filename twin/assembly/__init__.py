"""From an experiment to components and wires: the only place where the parts meet."""

from twin.assembly.robot import Assembly, assemble, belief, controller, plant_parameters

__all__ = ["Assembly", "assemble", "belief", "controller", "plant_parameters"]
