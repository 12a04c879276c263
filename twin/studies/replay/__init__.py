"""Replay of a robot's log: position and force from its encoder counts, and a verdict on whether robot and twin match.

`model` is the belief about the robot, `samples` the log's rows, `parts` the estimator and the plant model that a replay
and a live session share. `replay.replay_log` steps them over the log and judges the residuals.
"""
