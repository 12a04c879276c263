"""A twin beside its robot: the robot's state from what it sends, whether the two have parted, and since when.

`filter` has the state, `alarm` the decision, and `fleet` what is normal for robots of which nothing is wrong.
"""
