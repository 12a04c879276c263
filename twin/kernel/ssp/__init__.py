"""System Structure and Parameterization (SSP 1.0, 2.0): systems of FMUs, read and written, not run."""
