"""What the paper claims, as data with quotes, and how each claim is measured."""
