"""A part of the robot of another make, put to the test on what twin's own gets."""
