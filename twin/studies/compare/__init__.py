"""Comparison of two logs: the signals of the second that leave a tolerance tube around the first."""
