"""Whether the robot can do what an experiment says: its tables against its geometry, its encoders and its body."""
