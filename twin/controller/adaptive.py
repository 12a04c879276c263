"""What a controller may do besides the law of Fig. 3 B: know the tissue, take gains for it, go along with the breath.

All of it is optional and acts through the law: it sets the gains of the force loop, moves its integral and adds a shift
to its reference. A controller without it does not know of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.compiled.function import njit
from twin.controller.breath import BREATH, Breath, breathe
from twin.controller.schedule import (
    SCHEDULE,
    SchedulePoint,
    Scheduling,
    dither,
    follow_reference,
    schedule_gains,
    table_of,
)
from twin.controller.taps import TAPS
from twin.controller.tissue import TISSUE, Sensing, sense
from twin.cosim.port import Port, record
from twin.settings import numbers

ADAPTIVE_OUTPUTS = (
    Port("k_hat", 1, "N/m", "stiffness of the tissue, estimated while pressing; 0: not yet"),
    Port("k_std", 1, "N/m", "its standard error, grown by what may have changed since"),
    Port("c_hat", 1, "N s/m", "damping of the tissue and of the robot's joints, estimated with it"),
    Port("excited", 1, "1", "whether something moved enough to learn from", "bool"),
    Port("kp_F", 1, "m/N", "proportional gain of the force loop"),
    Port("ki_F", 1, "m/N s", "integral gain of the force loop"),
    Port("shift_z", 1, "m", "shift of the z reference besides dp_z: the dither"),
    Port("breath_rate", 1, "Hz", "rate of the breath that is followed; 0: none is looked for"),
    Port("breath_v", 1, "m/s", "velocity of the surface that is fed forward"),
)
ADAPTIVE = record(
    tissue=TISSUE,
    schedule=SCHEDULE,
    breath=BREATH,
    taps=TAPS,
    scheduled="i8",
    breathing="i8",
    pressing="i8",
    shift="f8",
    v_shift="f8",
    v="f8",
)
"""The parts; which of them are on; whether the force loop acted in the call before; shift of the z reference and its
rate, and velocity of the breath, of this call."""


@dataclass(frozen=True)
class Adapting:
    """What is asked for.

    Attributes:
        sensing: of the tissue.
        scheduling, points: gains over stiffness; None, none: those of the experiment.
        breathing: of the breath; None: it is not looked for.
        tap_learning: share of a tap's error in force that the next one corrects.
    """

    sensing: Sensing
    scheduling: Scheduling | None = None
    points: Sequence[SchedulePoint] = ()
    breathing: Breath | None = None
    tap_learning: float = 0.0
    table: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", table_of(self.points))

    def fill(self, memory: Any) -> dict[str, np.ndarray]:
        """Put the settings into `memory`, a record of `ADAPTIVE`; what else a controller's memory points to."""
        parts = {"tissue": self.sensing._asdict()}
        if self.scheduling is not None:
            parts["schedule"] = self.scheduling._asdict()
        if self.breathing is not None:
            parts["breath"] = numbers(self.breathing)
        for part, values in parts.items():
            for name, value in values.items():
                memory[part][name] = value
        memory["scheduled"], memory["breathing"] = self.scheduling is not None, self.breathing is not None
        memory["taps"]["share"] = self.tap_learning
        memory["schedule"]["count"] = len(self.table)
        return {"gain_table": self.table} if len(self.table) else {}


def with_adaptive(kind: np.dtype) -> np.dtype:
    """The memory `kind` of a controller, with room for what it does besides."""
    # first, because numba takes a record for one that it begins with, and warns of that
    return record(adaptive=ADAPTIVE, gain_table="i8", **{name: kind[name] for name in kind.names or ()})


@njit(cache=True)
def adapt(m, table, pid, h, z, F, J, F_ref):
    """What comes before a call of the law.

    Args:
        table: address of the points of the schedule.
        pid: the force loop.
        z, F, J: height (m), pressing force (N) and Jacobian (9,) as estimated, unfiltered.
        F_ref: reference of the force loop (N), in the call before.
    """
    tissue, pressing = m.tissue, m.pressing
    sense(tissue, h, z, F, J, pressing)
    m.shift, m.v_shift = dither(tissue, h, F, F_ref)
    m.v = 0.0
    if m.scheduled:
        schedule_gains(m.schedule, table, tissue, pid, h)
        m.v_shift += follow_reference(m.schedule, tissue.spring, pid, F_ref, pressing, h)
    if m.breathing:
        m.v = breathe(m.breath, tissue, h, z, F)
        m.v_shift += m.v
        pid.integral -= m.v * h


@njit(cache=True)
def tell(m, pid, pressing, y):
    """What comes after: note whether the force loop acts, and say what is recorded."""
    m.pressing = pressing
    tissue = m.tissue
    y.k_hat, y.k_std, y.c_hat, y.excited = tissue.k, tissue.std_late, tissue.c, tissue.excited
    y.kp_F, y.ki_F, y.shift_z = pid.kp, pid.ki, m.shift
    y.breath_rate, y.breath_v = m.breath.omega / (2.0 * np.pi), m.v
