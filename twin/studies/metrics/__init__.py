"""Numbers from curves: arrays in, numbers out."""
