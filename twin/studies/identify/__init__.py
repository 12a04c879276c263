"""Section III.A done right: what a press on a scale says about springs, zeros, backlash, friction and the scale.

A log becomes `windows` of slow motion; `balance` is what statics asks of them; `fit` finds the parameters that meet it,
how sure they are, and which of them the data cannot tell apart. `friction`, `motor_torque` and `one_pose` (the
paper's own procedure) follow. `identification.identified` is the door.
"""
