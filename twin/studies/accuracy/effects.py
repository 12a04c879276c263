"""Small effects of a real robot that an experiment leaves out as a rule: what they may be, and what is not modelled.

Values are plausible ones of a hand-sized robot with plain bearings, belts and magnetic encoders; docs/small_effects.md
says where each is from and what it moves.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from typing import Any

from twin.experiment.experiment import Experiment
from twin.experiment.variation import with_plant
from twin.plant.parameters import TrueRobot


@dataclass(frozen=True)
class Effect:
    """Of the true robot.

    Attributes:
        name, amount: for people.
        values: attributes of `robot.Plant`, SI: plausible ones; `ONE_TICK`: of the experiment.
        reason: why these.
    """

    name: str
    amount: str
    values: Mapping[str, Any]
    reason: str

    @property
    def label(self) -> str:
        """What is assumed, in words."""
        return f"{self.name}, {self.amount}"

    def in_force(self, experiment: Experiment) -> bool:
        """Whether the experiment has it."""
        return any(getattr(experiment.plant, name) != TrueRobot.model_fields[name].default for name in self.values)

    def of(self, experiment: Experiment, like: Experiment) -> Experiment:
        """`experiment` with the effect as `like` has it, or, if it has not, a plausible one."""
        given = {name: getattr(like.plant, name) for name in self.values}
        if not self.in_force(like):
            given = {name: experiment.cosim.tick if value is ONE_TICK else value for name, value in self.values.items()}
        return with_plant(experiment, **given)


def without_effects(experiment: Experiment) -> Experiment:
    """A robot that has none of them."""
    names = {name for effect in EFFECTS for name in effect.values}
    return with_plant(experiment, **{name: TrueRobot.model_fields[name].default for name in names})


ONE_TICK = "one tick"
MAGNET = "a magnet 0.2 mm off its axis; makers state 0.5 deg for a centred one, 1 deg within 0.5 mm"

EFFECTS = (
    Effect("joint friction", "2 mN m", {"joint_friction": 2e-3}, "four plain ball joints of 3 mm under 1.5 N, mu 0.1"),
    Effect("spring hysteresis", "2 %", {"spring_hysteresis": 0.02}, "of a steel spring that is clamped; assumed"),
    Effect(
        "belt", "0.004 rad/(N m)", {"belt_compliance": 4e-3}, "two spans of 60 mm, EA = 30 kN, on a pulley of 16 mm"
    ),
    Effect("motor encoders eccentric", "0.3 deg", {"motor_eccentricity": (radians(0.3),) * 3}, MAGNET),
    Effect("joint encoders eccentric", "0.3 deg", {"joint_eccentricity": (radians(0.3),) * 3}, MAGNET),
    Effect("late encoders", "a tick", {"encoder_latency": ONE_TICK}, "1 ms as a rule: a message of a bus at 1 kHz"),
    Effect(
        "tilted base", "2 deg", {"mounting_tilt": radians(2.0), "mounting_tilt_x": radians(2.0)},
        "about both axes; set up without a level",
    ),
    Effect("head beside O_P", "3 mm", {"head": (3e-3, 0.0, 0.0)}, "screwed on askew"),
    Effect(
        "hard stops", "15 deg", {"spring_stop": radians(15.0), "joint_lower": radians(-60.0),
                                 "joint_upper": radians(90.0)},
        "of springs, and of joints at -60 and 90 deg; only a fault meets them",
    ),
)  # fmt: skip

NOT_MODELLED = (
    ("bending links, yielding rods", 0.013, "3 N at the end of 60 mm of 9 mm aluminium: 0.01 mm"),
    ("play of ball joints", 0.0, "none: held closed by springs or magnets, as deltas are"),
    ("tilt of the platform", 0.002, "1.1 N, 30 mm below O_P, on rods that yield: 3e-5 rad, 1 um"),
    ("rods that spin", 0.001, "3e-8 kg m2 about their own axis"),
    ("springs that warm up", 0.01, "steel softens by 0.03 % per K: 10 K of 3 N"),
)
"""(what, at most N, why): estimates of docs/small_effects.md."""
