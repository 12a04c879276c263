"""Parts of the robot built for other people's masters."""
