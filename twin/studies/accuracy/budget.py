"""The accuracy budget: what each imperfection adds to the error of the force, by running without it and with it.

The error is the estimated less the true pressing force at the controller's ticks, over the time in which the robot
presses in every run. An ideal run has exact encoders, no backlash, a belief that is true and a fine coupling; its error
is what statics leave out (inertia and the joints' friction, Eq. 21-27 know neither). Each contribution is the change of
that error when one imperfection is put back, in a run of its own; the coupling's is the change of the true force, which
is the twin's own error and not the robot's.

Biases add up with their signs, scatter adds up as squares. Both sums are set beside the error of the experiment as it
is: what is missing there comes of imperfections that act on each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.variation import exactly_measured, with_cosim, with_model, with_plant
from twin.robot.model import Model
from twin.runs.assembly.roles import refuse_other_parts
from twin.runs.trace import run_in_memory
from twin.studies.accuracy.effects import EFFECTS, Effect, without_effects
from twin.studies.accuracy.uncertainty import UNCERTAINTIES
from twin.studies.steps import Say, Steps, silent

PRESSING = 0.5
"""Pressing force (N) above which an instant counts."""
SETTLED = 1.0
"""Time (s) after the first such instant that is left out: the touch-down is not what a massage is."""
FINER = 8
"""Steps of the fine coupling per tick of the experiment."""
BELIEFS = tuple(name for name in Model.model_fields if not name.endswith("_counts_per_turn"))
"""What a controller believes besides its encoders' resolution."""

Group = Literal["imperfection", "twin", "effect", "parameter", "total"]


@dataclass(frozen=True)
class Contribution:
    """One line of a budget, N.

    Attributes:
        label: for people.
        bias, std, rms: over the window; rms^2 = bias^2 + std^2.
        meaning: what was compared with what.
        group: "effect": not in the experiment, but plausible in a robot; "total": the experiment as it is.
    """

    label: str
    bias: float
    std: float
    rms: float
    meaning: str
    group: Group


@dataclass(frozen=True)
class Budget:
    """Of one experiment.

    Attributes:
        name: of the experiment.
        start, end: of the window (s).
        force: mean true pressing force in it (N).
        contributions: imperfections, the twin's own error, effects that the experiment leaves out, parameters.
        bias: sum of the biases of the imperfections (N).
        together: root of the sum of their squares.
        parameters: likewise of the parameters, which the run does not contain: its belief is true.
        as_is: the error of the experiment as it is.
    """

    name: str
    start: float
    end: float
    force: float
    contributions: tuple[Contribution, ...]
    bias: float
    together: float
    parameters: float
    as_is: Contribution

    def of(self, group: Group) -> tuple[Contribution, ...]:
        """The contributions of one group."""
        return tuple(one for one in self.contributions if one.group == group)


@dataclass(frozen=True)
class _Trace:
    """True and estimated pressing force at the controller's ticks, (n,) N."""

    true: NDArray[np.float64]
    estimate: NDArray[np.float64]

    @property
    def error(self) -> NDArray[np.float64]:
        return self.estimate - self.true


def accuracy_budget(experiment: Experiment, say: Say = silent) -> Budget:
    """Run `experiment` as it is, without any imperfection, and with each of them alone; `say` is told which.

    Raises:
        InputRefused: it has faults, taps, or never presses. ComponentFailed: a component failed.
    """
    refuse_other_parts(experiment, "a budget of the force error", ("estimator",))
    if experiment.faults:
        raise InputRefused(f"{experiment.name}: has faults, which no budget has a line for; remove [[fault]]")
    if any(task.kind == "tap" for task in experiment.tasks):
        raise InputRefused(
            f"{experiment.name}: taps turn round when the robot feels its way, so two runs do not press at the same "
            "time; take an experiment that presses, rolls or pushes"
        )
    # a monitor that does not trip does nothing to the force, and one that believes in other encoders trips
    experiment = replace(experiment, monitor=None)
    exact = _perfect(experiment)
    traces, believed = {}, {}
    alone = list(_ablations(experiment, exact))
    steps = Steps(say, len(alone) + len(EFFECTS) + len(UNCERTAINTIES))
    for name, one in alone:
        steps.next(name)
        traces[name] = _trace(one)
    others: list[tuple[Effect, _Trace]] = []
    for effect in EFFECTS:
        steps.next(effect.label)
        # the coupling's error is in both that are compared, so that no fine one is needed
        others.append((effect, _trace(effect.of(exact, experiment))))
    for uncertainty in UNCERTAINTIES:
        steps.next(uncertainty.label)
        believed[uncertainty] = _trace(uncertainty.of(_fine(exact)))
    window = _window(experiment, [*traces.values(), *(trace for _, trace in others), *believed.values()])
    ideal = traces["ideal"]

    def line(label: str, e: NDArray[np.float64], meaning: str, group: Group = "imperfection") -> Contribution:
        e = e[window]
        return Contribution(label, float(e.mean()), float(e.std()), float(np.sqrt(np.mean(e**2))), meaning, group)

    added = {name: trace.error - ideal.error for name, trace in traces.items()}
    imperfections = [
        line("encoder counts", added["counts"], "encoders as they are, instead of exact"),
        line("backlash", added["backlash"], "backlash as it is, taken off as far as the controller believes in it"),
        line("statics only", ideal.error, "what is left when all else is perfect: inertia and joint friction"),
    ]
    if "belief" in added:
        imperfections.append(
            line("belief", added["belief"], "the controller's parameters as they are, instead of true")
        )
    effects = [
        line(
            effect.name if own else effect.label, trace.error - traces["coupling"].error,
            "as it is, instead of none" if own else effect.reason, "imperfection" if own else "effect",
        )
        for effect, trace in others
        for own in (effect.in_force(experiment),)
    ]  # fmt: skip
    imperfections += [one for one in effects if one.group == "imperfection"]
    meaning = "true force at the experiment's coupling less that at a fine one: the twin's error, not the robot's"
    coupling = line("coupling", traces["coupling"].true - ideal.true, meaning, "twin")
    parameters = [line(u.label, t.error - ideal.error, u.reason, "parameter") for u, t in believed.items()]
    t = np.flatnonzero(window) * experiment.controller_ticks * experiment.cosim.tick
    return Budget(
        name=experiment.name,
        start=float(t[0]),
        end=float(t[-1]),
        force=float(traces["as it is"].true[window].mean()),
        contributions=(*imperfections, coupling, *(one for one in effects if one.group == "effect"), *parameters),
        bias=sum(one.bias for one in imperfections),
        together=_root_of_squares(imperfections),
        parameters=_root_of_squares(parameters),
        as_is=line(
            "as it is", traces["as it is"].error, "estimated less true force of the experiment as it is", "total"
        ),
    )


def _ablations(experiment: Experiment, exact: Experiment) -> Iterator[tuple[str, Experiment]]:
    """The ideal run, the experiment as it is, and one imperfection at a time, by name."""
    p, computer = experiment.plant, experiment.controller
    yield "as it is", experiment
    yield "ideal", _fine(exact)
    yield "coupling", exact
    counts = {"motor_counts_per_turn": p.motor_counts_per_turn, "joint_counts_per_turn": p.joint_counts_per_turn}
    counting = with_plant(exact, motor_noise=p.motor_noise, joint_noise=p.joint_noise, **counts)
    yield "counts", _fine(with_model(counting, **counts))
    loose = with_plant(exact, backlash=p.backlash)
    yield "backlash", _fine(_with_dead_zone(loose, computer.dead_zone))
    believed = {name: getattr(computer.model, name) for name in BELIEFS}
    if believed != {name: getattr(p, name) for name in BELIEFS}:
        yield "belief", _fine(with_model(exact, **believed))


def _perfect(experiment: Experiment) -> Experiment:
    """Exact encoders, no backlash and no belief in any, none of `EFFECTS`, a controller that knows every parameter."""
    exact = exactly_measured(without_effects(with_plant(experiment, backlash=0.0)))
    return _with_dead_zone(with_model(exact, **{name: getattr(exact.plant, name) for name in BELIEFS}), 0.0)


def _with_dead_zone(experiment: Experiment, half_width: float) -> Experiment:
    return replace(experiment, controller=experiment.controller.model_copy(update={"dead_zone": half_width}))


def _fine(experiment: Experiment) -> Experiment:
    return with_cosim(experiment, tick=experiment.cosim.tick / FINER, scheme="gauss_seidel", inputs="linear")


def _trace(experiment: Experiment) -> _Trace:
    true, estimate = "plant.F_ee_B", "estimator.F_ee_B"
    run = run_in_memory(experiment, experiment.controller_ticks, (true, estimate))
    return _Trace(-run[true][:, 2], -run[estimate][:, 2])


def _window(experiment: Experiment, traces: list[_Trace]) -> NDArray[np.bool_]:
    """Instants at which the robot presses in every run, from `SETTLED` after the first on, (n,)."""
    pressing = np.all([trace.true > PRESSING for trace in traces], axis=0)
    if not pressing.any():
        raise InputRefused(f"{experiment.name}: does not press with more than {PRESSING:g} N; there is no force to err")
    first = int(np.argmax(pressing)) + round(SETTLED / (experiment.controller_ticks * experiment.cosim.tick))
    pressing[:first] = False
    if not pressing.any():
        raise InputRefused(f"{experiment.name}: ends within {SETTLED:g} s of its first press; let it press longer")
    return pressing


def _root_of_squares(contributions: list[Contribution]) -> float:
    return float(np.sqrt(sum(one.rms**2 for one in contributions)))
