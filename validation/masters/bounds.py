"""What is run in other masters, and how close they have to come."""

DURATIONS = {"fig4_force_position": 20.0}
"""Seconds of each experiment."""
RANGE = 1e-11
RANGE_UNIT = "of the signal's range"
RANGE_REASON = (
    "a last bit in a step of a drive, 1e-16 of an angle, grows to some 1e-12 of the range of a speed; "
    "anything that is wrong is a million times larger. "
)
