"""The robot's computer, which knows only encoder counts and its own model of the robot."""
