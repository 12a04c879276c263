"""A picture on its way to the disk."""

from pathlib import Path
from typing import TYPE_CHECKING

from twin.writing import written

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(figure: "Figure", path: Path) -> None:
    """Write `figure` to `path`, in the format of its suffix; the same figure gives the same bytes.

    Raises:
        NotWritten: the folder or the disk refuses.
    """
    with written(path) as beside:
        figure.savefig(beside, metadata={"Software": None})
