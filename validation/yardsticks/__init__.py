"""A file for each yardstick; each has `YARDSTICKS`, and imports what it needs of others only when it is run."""
