"""Systems of FMUs as the standard SSP (System Structure and Parameterization 1.0, 2.0) writes them; nothing is run."""
