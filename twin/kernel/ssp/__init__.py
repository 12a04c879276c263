"""System Structure and Parameterization (SSP 1.0, 2.0): data classes, reader and writer of systems of FMUs."""
