"""What can keep two logs from being compared."""

from twin.errors import InputRefused


class ComparisonRefused(InputRefused):
    """Two logs, or the tolerances for them, do not fit together: what was found, what was expected, what to do."""
