"""An experiment: one TOML file, read, checked and turned into SI. Unit suffixes end here. Knows no component."""
