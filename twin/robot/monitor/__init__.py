"""Safety monitor: it reads encoder counts and commands, shares no state with the controller, and stops the robot.

It is on the floor of plant, controller and drive and imports no module from them: it uses the kinematics of
`twin.robot.mechanism` and its own model of the robot (see docs/safety.md).
"""
