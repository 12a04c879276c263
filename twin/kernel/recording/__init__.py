"""MCAP in and out: `writer.Writer` records topics of numbers, `reader.read` gives them back as arrays."""
