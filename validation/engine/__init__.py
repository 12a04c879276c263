"""The robot as bodies in somebody else's engine, beside `twin.robot.plant`."""
