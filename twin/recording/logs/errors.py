"""What can be wrong with a log."""

from twin.errors import InputRefused


class LogRefused(InputRefused):
    """A log or its column map cannot be used: which file, where in it, what was found, what was expected."""
