"""SSP systems of third-party FMUs, without a robot, in twin's master."""
