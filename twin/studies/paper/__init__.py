"""Claims of the paper as data with quotes, and the measure of each."""
