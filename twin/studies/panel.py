"""Panels of pictures and pages: one description of their curves, drawn by matplotlib here and by the page's script."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from twin.kernel.errors import UnknownSeries
from twin.studies.metrics.response import Curve

if TYPE_CHECKING:
    from twin.studies.figure import Axes

Role = Literal["truth", "belief", "reference", "shifted", "display"]
Samples = tuple[Curve, Curve]
"""Times (n,) in s, and values (n,) in the panel's unit."""
Reader = Callable[[Any], Samples | None]
"""Function that returns a run's samples of a curve, or None without any."""


class PanelCurve(NamedTuple):
    """One curve of a plot, in every run that has its signal.

    Attributes:
        role: meaning of the curve; decides colour and line style.
        member: index of the joint or axis, 0..2, which decides the colour if the panel shows several; -1 otherwise.
        shown: whether the page shows it at first.
        level: whether it is a constant, drawn across the whole picture.
    """

    label: str
    role: Role
    read: Reader
    member: int = -1
    shown: bool = True
    level: bool = False


class Panel(NamedTuple):
    """One plot with its curves, title and unit."""

    title: str
    unit: str
    quantities: tuple[PanelCurve, ...]


def draw_panel(axes: "Axes", panel: Panel, run: Any, looks: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw a plot's curves for a run; `looks`: style by label or role in drawing order, curves without are left out."""
    for name, look in looks.items():
        for curve in panel.quantities:
            if name in (curve.label, curve.role):
                try:
                    samples = curve.read(run)
                except UnknownSeries:
                    continue
                if samples is not None and curve.level:
                    axes.axhline(samples[1][0], **({"label": curve.label} | dict(look)))
                elif samples is not None:
                    axes.plot(*samples, **({"label": curve.label} | dict(look)))
