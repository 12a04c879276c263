"""The search, on runs that cost nothing, and once on the robot."""
