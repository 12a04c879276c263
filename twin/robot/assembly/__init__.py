"""Construction of the robot from an experiment: components and wiring."""
