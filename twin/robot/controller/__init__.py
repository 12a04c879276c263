"""What the robot's computer does: it knows encoder counts and its own model of the robot, nothing else."""
