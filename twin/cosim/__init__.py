"""Co-simulation: ports, components, wires, integer ticks and the compiled master. Knows no robot."""
