"""The robot of an experiment as parts that another master can run."""
