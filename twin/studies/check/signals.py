"""A run as an experiment's measures look at it: signals by the names that they use, at every tick."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.cosim.system import System
from twin.errors import InputRefused, SafetyTrip, nearest
from twin.experiment.experiment import Experiment
from twin.experiment.measure import Led, Measure, Required, Watched
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.beliefs import geometry_of
from twin.runs.loop import simulate
from twin.runs.streams import fields_of
from twin.runs.trace import Trace
from twin.studies.metrics.checked_requirement import checked_requirement

REFERENCE_THETA_L = "reference.theta_l"
"""Load angles (rad) at which the platform, as the controller believes it to be made, is at controller.p_ref_B."""


@dataclass(frozen=True)
class Signals:
    """Of a run that went to its end.

    Attributes:
        run: every signal of it at every tick.
        believed: what the controller believes the robot to be.
        fmus: SHA-256 of every FMU that took part, by file name.
    """

    run: Trace
    believed: Geometry
    fmus: dict[str, str] = field(default_factory=dict)

    @property
    def t(self) -> NDArray[np.float64]:
        """Times of the ticks (s), (n,)."""
        return self.run.t

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        """Values (n,) of a signal as [[measure]] writes it, (n, k) without an index where it has k components."""
        vector, index = split(signal.removeprefix("-"))
        values = self._theta_l if vector == REFERENCE_THETA_L else self.run.held(vector).astype(float, copy=False)
        values = values if index is None else values[:, index]
        return -values if signal.startswith("-") else values

    def unit(self, signal: str) -> str:
        """SI unit of a signal."""
        vector, _ = split(signal.removeprefix("-"))
        return "rad" if vector == REFERENCE_THETA_L else self.run.fields()[vector].unit

    @cached_property
    def _theta_l(self) -> NDArray[np.float64]:
        return joint_angles(self.believed, self["controller.p_ref_B"])


def split(signal: str) -> tuple[str, int | None]:
    """`plant.p_B[2]` as vector and index; None where it has none."""
    vector, bracket, index = signal.partition("[")
    return vector, int(index.removesuffix("]")) if bracket else None


def run_for_measures(experiment: Experiment) -> Signals:
    """Run `experiment` in this process.

    Raises:
        InputRefused: a drive FMU does not fit, or a measure names signals that there are not; all of those at once.
        ComponentFailed: a component failed.
        SafetyTrip: the safety monitor tripped.
    """
    run = Trace()
    with assemble(experiment) as assembly:
        refuse_unknown(experiment, assembly.system)
        done = simulate(assembly, experiment.duration_ticks, [run]).completed()
        if done.trip:
            raise SafetyTrip(f"{experiment.name}: {done.trip}")
        fmus = {fmu.path.name: fmu.sha256 for plan in assembly.drives for fmu in plan.parts.values()}
        fmus |= {part.label: part.sha256 for part in assembly.others.values()}
        return Signals(run, geometry_of(experiment.controller.model), fmus)


def refuse_unknown(experiment: Experiment, system: System) -> None:
    """Check that `system` has every signal which a measure of `experiment` looks at.

    Raises:
        InputRefused: it has not; all of those at once.
    """
    fields = fields_of(system)
    sizes = {name: field.size for name, field in fields.items()}
    sizes[REFERENCE_THETA_L] = 3
    mistakes = []
    for number, measure in enumerate(experiment.measures, start=1):
        if isinstance(measure, Required):
            try:
                checked_requirement(measure.formula, fields)
            except InputRefused as problem:
                mistakes.append(f"[measure {number}] formula = {problem}")
        for key, signal in _signals(measure):
            vector, index = split(signal.removeprefix("-"))
            said = f'[measure {number}] {key} = "{signal}"'
            if vector not in sizes:
                mistakes.append(f"{said}: no such signal; {nearest(vector, sizes, 'there are {}')}")
            elif (index is None) != (sizes[vector] == 1) or (index or 0) >= sizes[vector]:
                wanted = f"[0] to [{sizes[vector] - 1}]" if sizes[vector] > 1 else "no index"
                mistakes.append(f"{said}: it has {sizes[vector]} components; expected {wanted}")
    if mistakes:
        raise InputRefused("\n".join(f"{experiment.name}: {mistake}" for mistake in mistakes))


def _signals(measure: Measure) -> list[tuple[str, str]]:
    """(key, signal) of everything that `measure` looks at by name."""
    named = [("signal", measure.signal)] if isinstance(measure, Watched) else []
    return [*named, ("reference", measure.reference)] if isinstance(measure, Led) else named
