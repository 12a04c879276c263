"""The twin in place of the robot: its plant runs, publishes what a robot publishes, and obeys a controller."""
