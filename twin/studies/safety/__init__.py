"""Hazard table, the runs behind each of its lines, and the page that a reviewer follows from hazard to run."""
