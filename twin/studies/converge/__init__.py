"""What the coupling of drives and plant costs: error against a reference, order in the tick, power out of nothing."""
