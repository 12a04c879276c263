"""Experiments: TOML files that are read, checked and converted to SI, independent of any component."""
