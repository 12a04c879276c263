"""What gain and phase all loops may be off by at once, as a picture."""

from pathlib import Path

import numpy as np

from twin.studies.analyse.linear.disk import DiskMargin
from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.stability import PointStability, Stability
from twin.studies.analyse.text import point_name
from twin.studies.figure import BLUE, GREEN, ORANGE, picture

DISK_COLORS = {"laws": BLUE, "motors": ORANGE, "both": GREEN}
WIDEST = 24.0
"""dB that are drawn."""


def draw_disks(done: Stability, path: Path) -> None:
    """Write the picture to `path` (PNG): the stable point with the smallest disk, in air and pressing."""
    shown = [point for in_contact in (False, True) if (point := _tightest(done, in_contact)) is not None]
    with picture(path, 11, 4.6, f"All loops of {done.experiment.name} off at once") as figure:
        for axes, point in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            for where, disk in point.disks.items():
                gain, phase = outline(disk)
                axes.fill(gain, phase, color=DISK_COLORS[where], alpha=0.15, lw=0)
                axes.plot(gain, phase, color=DISK_COLORS[where], lw=1.3, label=f"{where}: {disk.alpha:.2f}")
            axes.set(xlim=(-WIDEST, WIDEST), ylim=(-100.0, 135.0), title=point_name(point.linear.point))
            axes.set(xlabel="gain of each loop, times (dB)", ylabel="phase of each loop, more by (degrees)")
            axes.legend(loc="upper center", ncols=3, title="inside, each as it likes", fontsize=9)


def outline(disk: DiskMargin) -> tuple[Matrix, Matrix]:
    """Gain (dB) and phase (degrees) along the edge of the disk."""
    delta = disk.alpha * np.exp(1j * np.linspace(1e-6, 2.0 * np.pi - 1e-6, 721))
    f = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
    return 20.0 * np.log10(np.abs(f)), np.angle(f, deg=True)


def _tightest(done: Stability, in_contact: bool) -> PointStability | None:
    there = [point for point in done.points if point.disks and point.linear.point.in_contact == in_contact]
    return min(there, key=lambda point: min(disk.alpha for disk in point.disks.values()), default=None)
