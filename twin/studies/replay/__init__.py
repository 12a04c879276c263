"""Logs of a robot through the twin: its encoders' counts give position and force again, and a verdict.

`robot_log` is what the robot recorded, `model` what the twin believes of it; `replay` steps the estimator over the log
and `plant_model` the plant beside it; `residual` says how they differ, `drift` since when. `replay.replayed` does all
of that.
"""
