"""Where the error of the force comes from, in newtons: the same experiment with and without each cause."""
