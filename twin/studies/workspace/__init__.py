"""Capability of a robot from its lengths, masses, springs, encoders and drives: reach, stiffness, forces, speeds."""
