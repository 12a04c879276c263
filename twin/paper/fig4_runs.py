"""The two runs behind Fig. 4, as curves."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from twin.errors import InputRefused
from twin.metrics.response import Curve, first_time, within
from twin.recording.recording import Recording

SWEEP = (10.7, 18.7)
"""From 2 s after the sweep along y has begun, when the lag of the position loop (1/kp) has died out, to its end (s)."""
FINAL = (19.0, 19.9)
"""After the sweep, at rest (s)."""
WHOLE = 19.9
"""What a recording has to cover (s)."""


class Series(Protocol):
    """Series of a run by name: a recording, or a run in memory."""

    @property
    def metadata(self) -> dict[str, dict[str, str]]: ...

    def __getitem__(self, key: str) -> np.ndarray: ...

    def time(self, topic: str) -> np.ndarray: ...


@dataclass(frozen=True)
class Fig4Run:
    """One run. Curves at the controller's rate on `t`, those of the plant (the truth) at the tick on `t_plant`."""

    recording: Series

    @cached_property
    def t(self) -> Curve:
        return self.recording.time("controller")

    @cached_property
    def t_plant(self) -> Curve:
        return self.recording.time("plant")

    @cached_property
    def F_z(self) -> Curve:
        """Pressing force as the controller estimates it, low-passed (N)."""
        return self.recording["controller.F_z"]

    @cached_property
    def F_ee_B(self) -> Curve:
        """Force on the environment as estimated, unfiltered (n, 3), N."""
        return self.recording["estimator.F_ee_B"]

    @cached_property
    def true_F_ee_B(self) -> Curve:
        return self.recording["plant.F_ee_B"]

    @cached_property
    def true_F_z(self) -> Curve:
        return -self.true_F_ee_B[:, 2]

    @cached_property
    def F_z_ref(self) -> float:
        return float(self.recording["controller.F_z_ref"][0])

    @cached_property
    def z(self) -> Curve:
        """z as the controller estimates it (m): what the paper's encoders give."""
        return self.recording["estimator.p_B"][:, 2]

    @cached_property
    def z_ref(self) -> Curve:
        """Pre-defined z reference (m)."""
        return self.recording["controller.p_ref_B"][:, 2]

    @cached_property
    def z_cmd(self) -> Curve:
        """z reference after the force loop (m)."""
        return self.recording["controller.p_cmd_B"][:, 2]

    @cached_property
    def true_z_error(self) -> Curve:
        """True z minus the pre-defined reference (m), at the controller's rate."""
        true_z = np.interp(self.t, self.t_plant, self.recording["plant.p_B"][:, 2])
        return true_z - self.z_ref

    @cached_property
    def trigger_time(self) -> float:
        """When the force loop was triggered (s); infinity: never."""
        return first_time(self.t, self.recording["controller.triggered"])

    def at(self, start: float, end: float) -> np.ndarray:
        """Mask of the controller's samples in a window."""
        return within(self.t, start, end)

    def truly_at(self, start: float, end: float) -> np.ndarray:
        """Mask of the plant's samples in a window."""
        return within(self.t_plant, start, end)


@dataclass(frozen=True)
class Fig4Runs:
    """The force-position run and the position-only run."""

    force_position: Fig4Run
    position: Fig4Run

    @property
    def tuned(self) -> dict[str, str]:
        """Parameters whose source says that they were tuned to meet the figure: key -> source."""
        origins = self.force_position.recording.metadata.get("origins", {})
        return {key: text for key, text in origins.items() if text.startswith("tuned")}


def fig4_runs(force_position: Recording, position: Recording) -> Fig4Runs:
    """The two recordings of Fig. 4.

    Raises:
        InputRefused: one is too short, or they stand in the wrong order.
    """
    for recording in (force_position, position):
        end = recording.time("controller")[-1] if len(recording.time("controller")) else 0.0
        if end < WHOLE:
            note = f" ({recording.note})" if recording.note else ""
            raise InputRefused(f"{recording.path}: ends at {end:.3f} s{note}; Fig. 4 needs {WHOLE} s, run it again")
    runs = Fig4Runs(Fig4Run(force_position), Fig4Run(position))
    if np.isinf(runs.force_position.trigger_time) and np.isfinite(runs.position.trigger_time):
        raise InputRefused(
            f"{force_position.path} has no force control and {position.path} has: give the force-position run first"
        )
    return runs
