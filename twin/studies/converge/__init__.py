"""Cost of the coupling of drives and plant: error against a reference, order in the tick, created power."""
