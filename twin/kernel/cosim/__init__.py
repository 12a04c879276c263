"""Co-simulation: ports, components, wires, integer ticks, the compiled master, systems as files. Knows no robot."""
