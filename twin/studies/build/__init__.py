"""Export of robot parts as FMUs, SSP archives and C."""
