"""From an experiment to components and wires: the only place where the parts meet."""
