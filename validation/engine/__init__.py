"""The robot as bodies in the engine of somebody else, beside `twin.plant`."""
