"""What can go wrong with a recording, each with the exit code of the process that ends with it."""

from twin.kernel.errors import InputRefused, NotWritten


class RecordingFailed(NotWritten):
    """A recording could not be written: disk full, no permission; what was written stays readable."""


class RecordingRefused(InputRefused):
    """A file is not a recording that can be read: missing, empty, not MCAP, or of another layout."""


class RecordingDamaged(RecordingRefused):
    """A recording's bytes are not those that were written; `salvage=True` reads what precedes the damage."""


class UnknownSeries(RecordingRefused, KeyError):
    """A recording was asked for a topic or field it does not hold.

    Args:
        sentence: for the user.
        key: what was asked for.
    """

    def __init__(self, sentence: str, key: str):
        super().__init__(sentence, key)
        self.key = key

    def __str__(self) -> str:
        # KeyError prints the repr of its argument, with quotes and escapes; the user gets the sentence
        return str(self.args[0])
