"""Whether an FMU does what the reference results say that came with it."""
