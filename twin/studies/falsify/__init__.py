"""Worst case by search: the fault, its onset, size and body that violate a requirement most."""
