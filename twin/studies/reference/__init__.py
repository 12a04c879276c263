"""Check of an FMU against the reference results shipped with it."""
