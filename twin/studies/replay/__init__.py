"""Logs of a robot through the twin: its encoders' counts give position and force again, and a verdict.

`model` is the belief about the robot, `samples` the log's rows, `parts` the estimator and the plant model that a replay
and a live session share. `replay.replayed` steps them over the log and judges the residuals.
"""
