"""The robot's computer: it knows encoder counts and its own model of the robot, nothing else."""
