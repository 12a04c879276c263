"""Logs of a robot through the twin: its encoders' counts give position and force again, and a verdict.

`model` is what the twin believes of the robot; `replay` steps the estimator over the log and the plant beside it, and
says how they differ, and since when. `replay.replayed` does all of that.
"""
