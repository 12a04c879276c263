"""Faults: components put into wires, behind drives and before parameters. Knows the robot's components by name only."""
