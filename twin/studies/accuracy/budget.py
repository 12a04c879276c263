"""Accuracy budget: the contribution of each imperfection to the force error, from runs with and without it.

The error is the estimated less the true pressing force at the controller's ticks, over the time that the robot presses
in every run. An ideal run has exact encoders, no backlash, true model parameters and a fine coupling; its error is the
effects that statics leave out (Eq. 21-27 have neither inertia nor joint friction). Each contribution is the change of
that error when one imperfection is restored in a run of its own. The coupling's contribution is the change of the true
force, i.e. the twin's own error and not the robot's.

Biases add with their signs, scatter adds as squares. Both sums are compared with the error of the unchanged experiment;
the difference is due to imperfections that interact.

The small effects of a real robot that experiments usually leave out have plausible values of a hand-sized robot with
plain bearings, belts and magnetic encoders; docs/physics.md has their sources. Each robot parameter has one
assumed standard uncertainty, with its reason.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment, with_cosim, with_exact_encoders, with_model, with_plant
from twin.robot.mechanism.geometry import Model
from twin.robot.plant.dynamics import TrueRobot
from twin.robot.run.trace import run_in_memory
from twin.studies.command import Say, Steps, ignore_progress
from twin.studies.result import Block, Column, Note, Result, Table

ONE_TICK = "one tick"
MAGNET_REASON = "a magnet 0.2 mm off its axis; makers state 0.5 deg for a centred one, 1 deg within 0.5 mm"
NOT_MODELLED = (
    ("bending links, yielding rods", 0.013, "3 N at the end of 60 mm of 9 mm aluminium: 0.01 mm"),
    ("play of ball joints", 0.0, "zero: closed by springs or magnets, as in delta robots"),
    ("tilt of the platform", 0.002, "1.1 N, 30 mm below O_P, on rods that yield: 3e-5 rad, 1 um"),
    ("rods that spin", 0.001, "3e-8 kg m2 about their own axis"),
    ("springs that warm up", 0.01, "steel softens by 0.03 % per K: 10 K of 3 N"),
)
"""(effect, upper bound (N), reason): estimates of docs/physics.md."""
SPRING_REASON = "two fits of the same springs differ by this much; the paper's own fit has one pose"
MASS_REASON = "of parts that are weighed, but whose rods are shared out between their ends by calculation"
LENGTH_REASON = "of machined parts with ball joints"
ZERO_REASON = "of a zero that is set against a mechanical stop"
MIN_PRESSING_FORCE = 0.5
"""Pressing force (N) above which an instant counts."""
TOUCHDOWN_TIME = 1.0
"""Time (s) left out after the first pressing instant, because the touch-down is not part of a massage."""
FINE_STEPS = 8
"""Steps of the fine coupling per tick of the experiment."""
BELIEVED_PARAMETERS = tuple(name for name in Model.model_fields if not name.endswith("_counts_per_turn"))
"""The controller's model parameters without the encoder resolutions."""
NAME_WIDTH = 36
NUMBER_COLUMNS = (Column("bias", 8, "+.4f"), Column("std", 8, ".4f"), Column("rms", 8, ".4f"))
Group = Literal["imperfection", "twin", "effect", "parameter", "total"]
Row = tuple[str, float | None, float | None, float]


@dataclass(frozen=True)
class Effect:
    """A small effect of the true robot that an experiment may leave out.

    Attributes:
        values: plausible values of attributes of `robot.Plant` (SI); `ONE_TICK` for the tick of the experiment.
    """

    name: str
    amount: str
    values: Mapping[str, Any]
    reason: str

    @property
    def label(self) -> str:
        return f"{self.name}, {self.amount}"

    def is_present(self, experiment: Experiment) -> bool:
        return any(getattr(experiment.plant, name) != TrueRobot.model_fields[name].default for name in self.values)

    def apply_to(self, experiment: Experiment, like: Experiment) -> Experiment:
        """Return the experiment with the small effect, as strong as in `like`, or plausibly strong if that lacks it."""
        given = {name: getattr(like.plant, name) for name in self.values}
        if not self.is_present(like):
            given = {name: experiment.cosim.tick if value is ONE_TICK else value for name, value in self.values.items()}
        return with_plant(experiment, **given)


def without_effects(experiment: Experiment) -> Experiment:
    names = {name for effect in SMALL_EFFECTS for name in effect.values}
    return with_plant(experiment, **{name: TrueRobot.model_fields[name].default for name in names})


SMALL_EFFECTS = (
    Effect("joint friction", "2 mN m", {"joint_friction": 2e-3}, "four plain ball joints of 3 mm under 1.5 N, mu 0.1"),
    Effect("spring hysteresis", "2 %", {"spring_hysteresis": 0.02}, "of a steel spring that is clamped; assumed"),
    Effect(
        "belt", "0.004 rad/(N m)", {"belt_compliance": 4e-3}, "two spans of 60 mm, EA = 30 kN, on a pulley of 16 mm"
    ),
    Effect("motor encoders eccentric", "0.3 deg", {"motor_eccentricity": (radians(0.3),) * 3}, MAGNET_REASON),
    Effect("joint encoders eccentric", "0.3 deg", {"joint_eccentricity": (radians(0.3),) * 3}, MAGNET_REASON),
    Effect("late encoders", "a tick", {"encoder_latency": ONE_TICK}, "1 ms as a rule: a message of a bus at 1 kHz"),
    Effect(
        "tilted base", "2 deg", {"mounting_tilt": radians(2.0), "mounting_tilt_x": radians(2.0)},
        "about both axes; set up without a level",
    ),
    Effect("head off O_P", "3 mm", {"head": (3e-3, 0.0, 0.0)}, "screwed on askew"),
    Effect(
        "hard stops", "15 deg", {"spring_stop": radians(15.0), "joint_lower": radians(-60.0),
                                 "joint_upper": radians(90.0)},
        "of springs, and of joints at -60 and 90 deg; only a fault meets them",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Uncertainty:
    """An assumed error of one parameter of the controller's robot model.

    Attributes:
        names: attributes of `robot.Model` that are off by the same amount at once.
        joint: index of the affected element, from 0; None for a scalar parameter.
        share, amount: relative (1) and absolute (SI) part; one of them is 0.
    """

    label: str
    names: tuple[str, ...]
    joint: int | None = None
    share: float = 0.0
    amount: float = 0.0
    reason: str = ""

    def apply_to(self, experiment: Experiment) -> Experiment:
        """Return the experiment with the parameter error in the controller's model; the true robot is unchanged."""
        model = experiment.controller.model
        off: dict[str, object] = {}
        for name in self.names:
            value = getattr(model, name)
            if self.joint is None:
                off[name] = value * (1.0 + self.share) + self.amount
            else:
                off[name] = tuple(v + self.amount * (i == self.joint) for i, v in enumerate(value))
        return with_model(experiment, **off)


UNCERTAINTIES = (
    Uncertainty("k_s +2 %", ("k_s",), share=0.02, reason=SPRING_REASON),
    # negative only, because a belt never returns more power than it receives
    Uncertainty("eta -2 %", ("eta",), share=-0.02, reason="belts of this kind lose 0 to 4 %"),
    Uncertainty("masses +5 %", ("m_a", "m_b", "m_p"), share=0.05, reason=MASS_REASON),
    *(Uncertainty(f"{name} +0.1 mm", (name,), amount=1e-4, reason=LENGTH_REASON) for name in ("a", "b", "l_a", "l_b")),
    *(
        Uncertainty(f"zero of {encoder} encoder {joint + 1} +0.05 deg", (name,), joint, amount=radians(0.05),
                    reason=ZERO_REASON)
        for encoder, name in (("motor", "motor_zero"), ("joint", "joint_zero"))
        for joint in range(3)
    ),
)  # fmt: skip
"""Assumed where the paper prints no value: Sec. III.A identifies k_s and eta only, without an uncertainty."""


@dataclass(frozen=True)
class Contribution:
    """Contribution of one imperfection to the force error: one row of the accuracy budget (N).

    Attributes:
        bias, std, rms: over the window; rms^2 = bias^2 + std^2.
        meaning: description of the two compared runs.
        group: "effect": plausible in a robot, but not in the experiment; "total": the unchanged experiment.
    """

    label: str
    bias: float
    std: float
    rms: float
    meaning: str
    group: Group

    JSON_KEYS = "label group bias_N=bias std_N=std rms_N=rms meaning"


@dataclass(frozen=True)
class Budget:
    """The accuracy budget of an experiment: its force error split by cause.

    Attributes:
        start, end: evaluated window (s).
        force: mean true pressing force in the window (N).
        contributions: imperfections, the twin's own error, effects that the experiment leaves out, parameters.
        bias: sum of the biases of the imperfections (N).
        together: root of the sum of squares of the imperfections (N).
        parameters: root of the sum of squares of the parameters (N); the run lacks them, since its model is true.
        as_is: error of the unchanged experiment.
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

    def contributions_of(self, group: Group) -> tuple[Contribution, ...]:
        return tuple(one for one in self.contributions if one.group == group)


class _Forces(NamedTuple):
    """True pressing force of a run and the error of its estimate at the controller's ticks, (n,) N."""

    true: NDArray[np.float64]
    error: NDArray[np.float64]


def accuracy_budget(experiment: Experiment, say: Say = ignore_progress) -> Budget:
    """Run an experiment unchanged, without imperfections and with each alone; return its accuracy budget."""
    refuse_third_party_parts(experiment, "a budget of the force error", ("estimator",))
    if experiment.faults:
        raise InputRefused(f"{experiment.name}: has faults, which an accuracy budget does not cover; remove [[fault]]")
    if any(task.kind == "tap" for task in experiment.tasks):
        raise InputRefused(
            f"{experiment.name}: taps turn at the measured force, so two runs do not press at the same "
            "time; choose an experiment that presses, rolls or pushes"
        )
    # a monitor that does not trip leaves the force unchanged, and one that assumes other encoders would trip
    experiment = replace(experiment, monitor=None)
    exact = _perfect(experiment)
    traces, believed = {}, {}
    alone = list(_ablations(experiment, exact))
    steps = Steps(say, len(alone) + len(SMALL_EFFECTS) + len(UNCERTAINTIES))
    for name, one in alone:
        steps.next(name)
        traces[name] = _trace(one)
    others: list[tuple[Effect, _Forces]] = []
    for effect in SMALL_EFFECTS:
        steps.next(effect.label)
        # both compared runs contain the coupling's error, so a fine coupling is not needed
        others.append((effect, _trace(effect.apply_to(exact, experiment))))
    for uncertainty in UNCERTAINTIES:
        steps.next(uncertainty.label)
        believed[uncertainty] = _trace(uncertainty.apply_to(_fine(exact)))
    window = _window(experiment, [*traces.values(), *(trace for _, trace in others), *believed.values()])
    ideal = traces["ideal"]

    def line(label: str, e: NDArray[np.float64], meaning: str, group: Group = "imperfection") -> Contribution:
        e = e[window]
        return Contribution(label, float(e.mean()), float(e.std()), float(np.sqrt(np.mean(e**2))), meaning, group)

    added = {name: trace.error - ideal.error for name, trace in traces.items()}
    imperfections = [
        line("encoder counts", added["counts"], "encoders as they are, instead of exact"),
        line("backlash", added["backlash"], "backlash as it is, taken off as far as the controller believes in it"),
        line("statics only", ideal.error, "the remainder if all else is perfect: inertia and joint friction"),
    ]
    if "belief" in added:
        meaning = "the controller's parameters as they are, instead of true"
        imperfections.append(line("belief", added["belief"], meaning))
    effects = [
        line(
            effect.name if own else effect.label, trace.error - traces["coupling"].error,
            "as it is, instead of none" if own else effect.reason, "imperfection" if own else "effect",
        )
        for effect, trace in others
        for own in (effect.is_present(experiment),)
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
    """Yield (name, experiment) of the runs of an accuracy budget: unchanged, ideal, and one imperfection at a time."""
    p, computer = experiment.plant, experiment.controller
    yield "as it is", experiment
    yield "ideal", _fine(exact)
    yield "coupling", exact
    counts = {"motor_counts_per_turn": p.motor_counts_per_turn, "joint_counts_per_turn": p.joint_counts_per_turn}
    counting = with_plant(exact, motor_noise=p.motor_noise, joint_noise=p.joint_noise, **counts)
    yield "counts", _fine(with_model(counting, **counts))
    loose = with_plant(exact, backlash=p.backlash)
    yield "backlash", _fine(_with_dead_zone(loose, computer.dead_zone))
    believed = {name: getattr(computer.model, name) for name in BELIEVED_PARAMETERS}
    if believed != {name: getattr(p, name) for name in BELIEVED_PARAMETERS}:
        yield "belief", _fine(with_model(exact, **believed))


def _perfect(experiment: Experiment) -> Experiment:
    """Return the experiment without imperfections: exact encoders, no backlash or small effects, a true model."""
    exact = with_exact_encoders(without_effects(with_plant(experiment, backlash=0.0)))
    return _with_dead_zone(with_model(exact, **{name: getattr(exact.plant, name) for name in BELIEVED_PARAMETERS}), 0.0)


def _with_dead_zone(experiment: Experiment, half_width: float) -> Experiment:
    return replace(experiment, controller=experiment.controller.model_copy(update={"dead_zone": half_width}))


def _fine(experiment: Experiment) -> Experiment:
    return with_cosim(experiment, tick=experiment.cosim.tick / FINE_STEPS, scheme="gauss_seidel", inputs="linear")


def _trace(experiment: Experiment) -> _Forces:
    true, estimate = "plant.F_ee_B", "estimator.F_ee_B"
    run = run_in_memory(experiment, experiment.controller_ticks, (true, estimate))
    return _Forces(-run[true][:, 2], run[true][:, 2] - run[estimate][:, 2])


def _window(experiment: Experiment, traces: list[_Forces]) -> NDArray[np.bool_]:
    """Return the mask (n,) of the instants that an accuracy budget evaluates: the robot presses in every run.

    It begins `TOUCHDOWN_TIME` after the first such instant.
    """
    pressing = np.all([trace.true > MIN_PRESSING_FORCE for trace in traces], axis=0)
    if not pressing.any():
        raise InputRefused(
            f"{experiment.name}: presses with {MIN_PRESSING_FORCE:g} N at most, so there is no force error"
        )
    first = int(np.argmax(pressing)) + round(TOUCHDOWN_TIME / (experiment.controller_ticks * experiment.cosim.tick))
    pressing[:first] = False
    if not pressing.any():
        raise InputRefused(
            f"{experiment.name}: ends within {TOUCHDOWN_TIME:g} s of its first press; let it press longer"
        )
    return pressing


def _root_of_squares(contributions: list[Contribution]) -> float:
    return float(np.sqrt(sum(one.rms**2 for one in contributions)))


def accuracy_result(budget: Budget, facts: str) -> Result:
    """Return the report of an accuracy budget, which refers to the JSON file `facts`."""
    imperfections, twin = budget.contributions_of("imperfection"), budget.contributions_of("twin")
    together = ("sum of biases, root of squares", budget.bias, None, budget.together)
    added = ("root of the sum of squares", None, None, budget.parameters)
    left_out = [
        f"  {what:<{NAME_WIDTH - 3}}{'not modelled, at most':>21}{most:>9.3f}" for what, most, _ in NOT_MODELLED
    ]
    parts: list[Block] = [
        *(Note(sentence, "  ") for sentence in details(budget)),
        "",
        _table("in this run, N", [*map(row, imperfections), together, row(budget.as_is)]),
        "",
        _table("the twin itself, N", [*map(row, twin)]),
        "",
        _table("left out; if the robot had, N", [*map(row, budget.contributions_of("effect")), *left_out]),
        "",
        _table("if the controller believed, N", [*map(row, budget.contributions_of("parameter")), added]),
        "",
        *(Note(f"{one.label}: {one.meaning}", "  ", 4) for one in (*imperfections, *twin)),
    ]
    files = {"facts": facts}
    return Result(f"{budget.name}: {headline(budget)}", parts, accuracy_facts(budget) | files, files)


def _table(title: str, rows: Sequence[Row | str]) -> Table:
    return Table([Column(title, NAME_WIDTH, left=True), *NUMBER_COLUMNS], rows)


def headline(budget: Budget) -> str:
    return f"the force is estimated to {budget.as_is.rms:.3f} N rms"


def details(budget: Budget) -> tuple[str, str]:
    """Return two clauses on an accuracy budget: mean error with its largest cause, effect of parameter errors."""
    total, worst = budget.as_is, max(budget.contributions_of("imperfection"), key=lambda one: one.rms)
    off = f"{abs(total.bias):.3f} N too {'high' if total.bias > 0.0 else 'low'}"
    # 0.5 mN rounds to zero in the three digits shown
    off = off if abs(total.bias) >= 5e-4 else "right"
    return (
        f"pressing {budget.force:.2f} N, {budget.start:.2f} to {budget.end:.2f} s: {off} on average, "
        f"{total.std:.3f} N of scatter; most of it is {worst.label}",
        f"assumed parameter errors may add {budget.parameters:.3f} N",
    )


def row(one: Contribution) -> Row:
    """Return the table row of a contribution to the force error: label, bias, standard deviation, rms (N)."""
    return one.label, one.bias, one.std, one.rms


def accuracy_facts(budget: Budget) -> dict[str, object]:
    """Return all numbers of an accuracy budget (N, s) as the content of `accuracy.json`."""
    return {
        "experiment": budget.name,
        "start_s": budget.start,
        "end_s": budget.end,
        "force_N": budget.force,
        "contributions": to_dict((*budget.contributions, budget.as_is)),
        "not_modelled": [{"label": what, "at_most_N": most, "meaning": why} for what, most, why in NOT_MODELLED],
        "bias_N": budget.bias,
        "together_N": budget.together,
        "parameters_N": budget.parameters,
    }
