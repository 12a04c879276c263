"""Units of columns."""

from twin.errors import nearest
from twin.recording.logs.errors import LogRefused
from twin.units import ATOMS, Unit, known_unit


def unit(text: str, where: str) -> Unit:
    """The unit that `text` spells.

    Args:
        text: `mm`, `rad/s`, `deg_per_s`.
        where: begins the sentence of the refusal: file and column.

    Raises:
        LogRefused: there is no such unit; it names the nearest.
    """
    found = known_unit(text)
    if found is None:
        hint = nearest(text, ATOMS, "expected one such as mm, N, deg, rad/s, Nm, ms, A or 1")
        raise LogRefused(f"{where}: unknown unit '{text}'; {hint}")
    return found
