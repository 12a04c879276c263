"""Healthy robot of an experiment on one body at one place, and its runs with faults."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import Fault
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.studies.faults.cases import faults_of
from twin.studies.faults.offsets import NO_OFFSET, moved_settings
from twin.studies.faults.onsets import checked_healthy_run, default_onsets, touching
from twin.studies.faults.reaction import REACTION_SIGNALS, Reaction, reaction

MAX_PASTS = 4
"""Pasts of one experiment: with and without the monitor, with and without a surface that moves."""


class Stage:
    """Experiment on one body at one place, for repeated runs with faults; a context manager frees their states.

    Runs with faults continue from the last state of the healthy run before the fault. Until the monitor acts, the robot
    without it has the same bits: if it never acts, the run also serves as the run without it.

    Args:
        body: name of the body; "" for the experiment's own.
        offset: offset of all tasks, x and y (m).
        settings: `key=value` applied to the experiment's file.
        onsets: onsets of faults (s); default: in free motion and in contact.
        share: False to make every run from the start, with the same bits.
    """

    def __init__(
        self,
        experiment: Experiment,
        body: str = "",
        offset: tuple[float, float] = NO_OFFSET,
        settings: Sequence[str] = (),
        onsets: Sequence[float] = (),
        share: bool = True,
    ):
        self.experiment, self.body, self.offset, self.settings = experiment, body, offset, tuple(settings)
        self._onsets, self._share = tuple(onsets), share
        self._runs = Runs(RunRequest(REACTION_SIGNALS, idle=True), most=MAX_PASTS if share else 0)
        self._trips: dict[tuple[Fault, ...], float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the saved states shared by the runs; a later run creates them again."""
        self._runs.close()

    @cached_property
    def healthy(self) -> Outcome:
        return checked_healthy_run(self.experiment)

    @cached_property
    def onsets(self) -> tuple[float, ...]:
        """Onsets (s) of the faults to inject."""
        return self._onsets or tuple(tick * self.experiment.cosim.tick for tick in default_onsets(self.healthy))

    def touches(self, onset: float) -> bool:
        """Check whether the healthy robot touches the body at `onset` (s)."""
        return bool(touching(self.healthy)[round(onset / self.experiment.cosim.tick)])

    def run(self, faults: Sequence[Fault], watched: bool = True) -> Outcome:
        """Run with `faults`, with the monitor or without; raise `InputRefused` if a drive or fault does not fit."""
        monitor = self.experiment.monitor if watched else None
        return self._runs.run(replace(self.experiment, faults=tuple(faults), monitor=monitor))

    def both(self, faults: Sequence[Fault]) -> tuple[Outcome, Outcome]:
        """Run the experiment with `faults` twice, with the monitor and without, and return both runs."""
        watched = self.run(faults)
        # the error message of a failed run may name an input of the monitor
        same = self._share and watched.idle and watched.failure is None
        return watched, watched if same else self.run(faults, watched=False)

    def reaction(self, faults: Sequence[Fault], watched: bool = True) -> Reaction:
        return reaction(self.run(faults, watched), self.experiment, _onset(faults))

    def reactions(self, faults: Sequence[Fault]) -> tuple[Reaction, Reaction]:
        watched, unwatched = self.both(faults)
        one = reaction(watched, self.experiment, _onset(faults))
        return one, one if unwatched is watched else reaction(unwatched, self.experiment, _onset(faults))

    def ideal_reaction(self, faults: Sequence[Fault], seen: float) -> Reaction:
        """Compute the reaction to `faults` with an ideal monitor, which cuts all power `seen` (s) after the onset."""
        off = Fault("power_off", "power", _onset(faults) + round(seen / self.experiment.cosim.tick))
        return replace(self.reaction((*faults, off)), power_off=seen)

    def trip_after(self, first: dict[str, Any]) -> float:
        """Run a single [[fault]], and return the time (s) from its onset to the trip; 0 without a trip."""
        faults = faults_of(self.experiment, [first])
        if faults not in self._trips:
            self._trips[faults] = self.reaction(faults).seen or 0.0
        return self._trips[faults]

    def delay_second(self, tables: Sequence[dict[str, Any]], delay: float) -> tuple[dict[str, Any], ...]:
        """Return two [[fault]] `tables`, the second `delay` (s) after the trip of the first, or after its onset."""
        first, second = tables
        tick, last = self.experiment.cosim.tick, self.experiment.duration_ticks - 1
        later = min(round((first["onset_s"] + self.trip_after(first) + delay) / tick), last)
        return first, second | {"onset_s": float(f"{later * tick:.12g}")}


def load_stage(
    path: Path,
    settings: Sequence[str] = (),
    body: str | None = None,
    offset: tuple[float, float] = NO_OFFSET,
    drive: str | None = None,
    onsets: Sequence[float] = (),
    share: bool = True,
) -> Stage:
    """Load an experiment on `body` with its tasks moved by `offset` (m), and run it once healthy; see `Stage`."""
    experiment = load_experiment(path, settings, drive, body)
    moved = moved_settings(experiment, offset)
    if moved:
        experiment = load_experiment(path, (*settings, *moved), drive, body)
    stage = Stage(experiment, body or "", offset, (*settings, *moved), onsets, share)
    # its errors are raised here rather than at the first fault
    _ = stage.healthy, stage.onsets
    return stage


def _onset(faults: Sequence[Fault]) -> int:
    """Return the tick of the first onset of several faults; 0 without faults."""
    return min((fault.onset for fault in faults), default=0)
