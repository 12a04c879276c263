"""Feasibility of an experiment: its tables against the robot's geometry, encoders and body."""
