"""The twin beside a robot that runs: it follows the robot's stamps, knows its state, and sees them part.

`filter` has the state, `alarm` the decision, and `fleet` what is normal for robots of which nothing is wrong.
"""
