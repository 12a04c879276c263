"""What identification may have to say instead of a number."""

from twin.errors import TwinError


class NotIdentifiable(TwinError):
    """The log is in order, but what was asked cannot be had from it: why, and what to record instead."""

    exit_code = 1
