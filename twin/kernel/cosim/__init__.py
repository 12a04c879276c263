"""Co-simulation: ports, components, wires, integer ticks, the compiled master, saved states. Knows no robot."""
