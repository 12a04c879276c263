"""Mutants: one small change of the source at a time, and whether a test notices (`make mutants`, docs/building.md)."""
