"""The paper's claims as data with quotes, and the measure of each."""
