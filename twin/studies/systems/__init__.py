"""Systems of other people's FMUs (SSP), without a robot, in the master of the twin."""
