"""The twin beside a robot that runs: it follows the robot's stamps and says where the two part."""
