"""From the faults of an experiment to components between the wires of the healthy robot."""
