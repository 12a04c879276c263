"""Two logs beside each other: which signals of the second leave a tolerance tube around the first, and where."""
