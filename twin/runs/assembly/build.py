"""An experiment on its way to components: what several of them have to know when they are made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.cosim.component import Component
from twin.experiment.experiment import Experiment
from twin.plant.component import Plant
from twin.runs.assembly.drives import DrivePlan, Start, drive


class DriveMaker(Protocol):
    """What makes the component of a drive.

    Attributes:
        one_process: whether all drives that it makes live in this process.
    """

    one_process: bool

    def drive(self, name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
        """As `twin.runs.assembly.drives.drive`."""


class InThisProcess:
    """Drives as they are."""

    one_process = True
    drive = staticmethod(drive)


@dataclass(frozen=True)
class Build:
    """The robot at rest in static equilibrium at the start of its experiment.

    Attributes:
        experiment: what to build.
        plans: of the three joints' drives. maker: of the drives.
        plant: at rest. theta_m: the motor angles that hold it there (3,), rad.
    """

    experiment: Experiment
    plans: tuple[DrivePlan, ...]
    maker: DriveMaker
    plant: Plant
    theta_m: NDArray[np.float64]


Makers = Mapping[str, Callable[[], Component]]
"""What makes the components of a row of the robot's table, by their names; nothing where there is none."""
Parts = Callable[[Build], Makers]
