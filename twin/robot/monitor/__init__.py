"""The safety monitor: reads encoder counts and commands, shares no state with the controller, stops the robot.

It is on the floor of plant, controller and drive and imports none of them: its kinematics are those of
`twin.robot.mechanism`, its model of the robot is its own (see docs/safety.md).
"""
