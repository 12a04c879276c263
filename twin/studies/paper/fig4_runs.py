"""The two runs behind Fig. 4, as curves and as the picture of Fig. 4 A-D."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.recording.errors import UnknownSeries
from twin.kernel.recording.recording import Recording
from twin.studies.figure import GREY, INK, PAPER_BLUE, PAPER_ORANGE, PAPER_YELLOW, Axes, picture
from twin.studies.metrics.requirement import FIG4, lacking
from twin.studies.metrics.response import Curve, first_time, within

SWEEP = (10.7, 18.7)
"""From 2 s after the sweep along y has begun, when the lag of the position loop (1/kp) has died out, to its end (s)."""
BEFORE = (8.0, 8.6)
"""Before the sweep, at rest (s)."""
FINAL = (19.0, 19.9)
"""After the sweep, at rest (s)."""
WHOLE = 19.9
"""What a recording has to cover (s)."""
PARTS = ((0.72, 5.82), (5.82, 8.7), (8.7, 18.7), (18.7, WHOLE))
"""Of a whole curve: descent, arrival, sweep, end (s)."""
WAY = 0.020
"""Least way along -y (m) that counts as a sweep: half of the paper's 40 mm."""
SYMMETRIC = 1e-3
"""Force in x (N) below which a run is symmetrical."""


class RunSeries(Protocol):
    """Series of a run by name: a recording, or a run in memory."""

    @property
    def metadata(self) -> dict[str, dict[str, str]]: ...

    def __getitem__(self, key: str) -> np.ndarray: ...

    def time(self, topic: str) -> np.ndarray: ...


def _read(of: Callable[[RunSeries], Curve]) -> "cached_property[Curve]":
    return cached_property(lambda run: of(run.recording))


@dataclass(frozen=True)
class Fig4Run:
    """One run. Curves at the controller's rate on `t`, those of the plant (the truth) at the tick on `t_plant`.

    Attributes:
        t, t_plant, t_scale: times (n,), s, of controller, plant and electronic scale.
        F_z, F_ee_B: pressing force as the controller estimates it, low-passed (N); force on the environment as
            estimated, unfiltered (n, 3), N.
        F_z_ref: what the former should be (N).
        true_F_z, true_F_ee_B: the same in truth, on `t_plant`.
        scale_F_z: the scale's reading (N), on `t_scale`.
        p_B, z: position as the controller estimates it (n, 3), m: what the paper's encoders give; its height.
        z_ref, z_cmd: height asked for, pre-defined and after the force loop (m).
        true_z: in truth, on `t_plant`.
    """

    recording: RunSeries

    t = _read(lambda series: series.time("controller"))
    t_plant = _read(lambda series: series.time("plant"))
    t_scale = _read(lambda series: series.time("scale"))
    F_z = _read(lambda series: series["controller.F_z"])
    F_ee_B = _read(lambda series: series["estimator.F_ee_B"])
    true_F_ee_B = _read(lambda series: series["plant.F_ee_B"])
    true_F_z = _read(lambda series: -series["plant.F_ee_B"][:, 2])
    scale_F_z = _read(lambda series: series["scale.F_z"])
    p_B = _read(lambda series: series["estimator.p_B"])
    z = _read(lambda series: series["estimator.p_B"][:, 2])
    z_ref = _read(lambda series: series["controller.p_ref_B"][:, 2])
    z_cmd = _read(lambda series: series["controller.p_cmd_B"][:, 2])
    true_z = _read(lambda series: series["plant.p_B"][:, 2])

    @property
    def is_in_step(self) -> bool:
        """Whether estimator and controller tell of the same instants, as they do where nothing was lost."""
        return np.array_equal(self.recording.time("estimator"), self.t)

    @cached_property
    def true_z_error(self) -> Curve:
        """True z minus the pre-defined reference (m), at the controller's rate."""
        return np.interp(self.t, self.t_plant, self.true_z) - self.z_ref

    @cached_property
    def F_z_ref(self) -> float:
        return float(self.recording["controller.F_z_ref"][0])

    @cached_property
    def trigger_time(self) -> float:
        """When the force loop was triggered (s); infinity: never."""
        return first_time(self.t, self.recording["controller.triggered"])

    @cached_property
    def sweeps(self) -> bool:
        """Whether the platform moves along -y while it should."""
        y = self.p_B[self.at(*SWEEP), 1]
        return bool(y[0] - y[-1] >= WAY)

    def at(self, start: float, end: float) -> np.ndarray:
        """Mask of the controller's samples in a window."""
        return within(self.t, start, end)

    def truly_at(self, start: float, end: float) -> np.ndarray:
        """Mask of the plant's samples in a window."""
        return within(self.t_plant, start, end)


@dataclass(frozen=True)
class Fig4Runs:
    """The force-position run and the position-only run.

    Attributes:
        imperfect: the same two of a robot and a scale that are not symmetrical, for the forces in x; None: there are
            none, and nothing is said of these.
    """

    force_position: Fig4Run
    position: Fig4Run
    imperfect: "tuple[Fig4Run, Fig4Run] | None" = None

    @property
    def without_x(self) -> str:
        """Why these runs say nothing about forces in x, or ""."""
        if self.imperfect is None:
            return "needs the runs of fig4_imperfect.toml and fig4_imperfect_position.toml as well"
        if all(np.max(np.abs(run.true_F_ee_B[:, 0])) < SYMMETRIC for run in self.imperfect):
            return "the true F_x is 0 by symmetry"
        return ""

    @property
    def missing(self) -> dict[str, list[str]]:
        """Series that claims are judged on and a recorded run lacks, by the run's file."""
        runs = [self.force_position, self.position, *(self.imperfect or ())]
        recorded = [run.recording for run in runs if isinstance(run.recording, Recording)]
        found = {str(one.path): lacking(FIG4, one.fields()) for one in recorded}
        return {path: names for path, names in found.items() if names}

    @property
    def tuned(self) -> dict[str, str]:
        """Parameters whose source says that they were tuned to meet the text: key -> source."""
        runs = (self.force_position, *(self.imperfect[:1] if self.imperfect else ()))
        origins = [run.recording.metadata.get("origins", {}) for run in runs]
        return {key: text for one in origins for key, text in one.items() if text.startswith("tuned")}


def fig4_runs(force_position: Recording, position: Recording, *imperfect: Recording) -> Fig4Runs:
    """The recordings of Fig. 4.

    Args:
        imperfect: the same two of fig4_imperfect.toml and fig4_imperfect_position.toml, or none.

    Raises:
        InputRefused: as `checked_run`, or they stand in the wrong order.
    """
    pairs = [(force_position, position), *([(imperfect[0], imperfect[1])] if imperfect else [])]
    ideal, *others = [_checked_pair(*pair) for pair in pairs]
    return Fig4Runs(*ideal, *others)


def checked_run(recording: Recording) -> Fig4Run:
    """A recording of Fig. 4 that can be judged.

    Raises:
        InputRefused: it is too short, or has lost estimates.
    """
    run = Fig4Run(recording)
    end = run.t[-1] if len(run.t) else 0.0
    if end < WHOLE:
        note = f" ({recording.note})" if recording.note else ""
        raise InputRefused(f"{recording.path}: ends at {end:.3f} s{note}; Fig. 4 needs {WHOLE} s, run it again")
    if not run.is_in_step:
        raise InputRefused(f"{recording.path}: estimator and controller tell of different times; run it again")
    return run


def _checked_pair(force_position: Recording, position: Recording) -> tuple[Fig4Run, Fig4Run]:
    pair = checked_run(force_position), checked_run(position)
    if any("controller.triggered" not in one.fields() for one in (force_position, position)):
        return pair
    if np.isinf(pair[0].trigger_time) and np.isfinite(pair[1].trigger_time):
        raise InputRefused(
            f"{force_position.path} has no force control and {position.path} has: give the force-position run first"
        )
    return pair


PRE_DEFINE, P_BASED, FP_BASED, FP_REFERENCE, TRUTH = PAPER_BLUE, PAPER_YELLOW, PAPER_ORANGE, GREY, INK
WIDE, THIN = 1.6, 0.9
"""Weights of lines (pt), the same in all panels; legends have one order, too."""


def draw_fig4(runs: Fig4Runs, path: Path) -> None:
    """Write the picture to `path` (PNG). Forces are the controller's estimates; the true F_z is dotted.

    A series that a run lacks is left out.
    """
    with picture(path, 12, 7.5) as figure:
        (a, b), (c, d) = figure.subplots(2, 2, sharex=True)
        _draw_z(a, runs)
        _draw_force(b, runs)
        _draw_friction(c, runs.imperfect, 0, "x")
        _draw_friction(d, (runs.force_position, runs.position), 1, "y")
        limits = [min(c.get_ylim()[0], d.get_ylim()[0]), max(c.get_ylim()[1], d.get_ylim()[1])]
        c.set_ylim(*limits)
        d.set_ylim(*limits)
        for axes, letter in ((a, "A"), (b, "B"), (c, "C"), (d, "D")):
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.set_xlim(0, 20)
        # ideal runs have no force in x, by symmetry
        text = runs.without_x or "imperfect runs: scale tilted, encoders off zero"
        c.set_title(text, loc="right", fontsize="small")
        for axes in (c, d):
            axes.set_xlabel("time (s)")


def _draw_z(axes: Axes, runs: Fig4Runs) -> None:
    fp, p = runs.force_position, runs.position
    with suppress(UnknownSeries):
        axes.plot(fp.t, 1e3 * fp.z_ref, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    axes.plot(p.t, 1e3 * p.z, color=P_BASED, lw=WIDE, label="P-based")
    axes.plot(fp.t, 1e3 * fp.z, color=FP_BASED, lw=WIDE, label="F&P-based")
    with suppress(UnknownSeries):
        axes.plot(fp.t, 1e3 * fp.z_cmd, color=FP_REFERENCE, lw=THIN, label="F&P-based-ref")
    axes.set_ylabel("z position (mm)")
    axes.legend(loc="upper right")


def _draw_force(axes: Axes, runs: Fig4Runs) -> None:
    fp, p = runs.force_position, runs.position
    with suppress(UnknownSeries):
        axes.axhline(fp.F_z_ref, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    for run, color, label in ((p, P_BASED, "P-based"), (fp, FP_BASED, "F&P-based")):
        with suppress(UnknownSeries):
            axes.plot(run.t, run.F_z, color=color, lw=WIDE, label=label)
    axes.plot(p.t_plant, p.true_F_z, color=TRUTH, lw=THIN, ls=":", label="true force (plant)")
    axes.plot(fp.t_plant, fp.true_F_z, color=TRUTH, lw=THIN, ls=":")
    axes.set_ylabel("F_z, pressing (N)")
    axes.legend(loc="lower right")


def _draw_friction(axes: Axes, pair: tuple[Fig4Run, Fig4Run] | None, axis: int, letter: str) -> None:
    axes.axhline(0.0, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    # noise drawn wide is a block of colour
    for run, color, label in zip(reversed(pair or ()), (P_BASED, FP_BASED), ("P-based", "F&P-based"), strict=False):
        axes.plot(run.t, run.F_ee_B[:, axis], color=color, lw=THIN, label=label)
    axes.set_ylabel(f"F_{letter} (N)")
    axes.legend(loc="lower left")
