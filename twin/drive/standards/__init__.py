"""The versions of the FMI, each in its own words: how an FMU is loaded, instantiated and brought into step mode."""
