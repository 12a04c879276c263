"""How well a robot's parameters are known: one standard uncertainty each, assumed, with the reason."""

from dataclasses import dataclass
from math import radians

from twin.experiment.experiment import Experiment
from twin.experiment.variation import with_model


@dataclass(frozen=True)
class Uncertainty:
    """Of one believed parameter.

    Attributes:
        label: for people.
        names: attributes of `robot.Model` that are off by the same amount at once.
        joint: which of three values, counted from 0; None: a single number.
        share, amount: relative (1) and absolute (SI) part; one of them is 0.
        reason: why that much.
    """

    label: str
    names: tuple[str, ...]
    joint: int | None = None
    share: float = 0.0
    amount: float = 0.0
    reason: str = ""

    def of(self, experiment: Experiment) -> Experiment:
        """`experiment` whose controller believes otherwise by this; what is true stays."""
        model = experiment.controller.model
        off: dict[str, object] = {}
        for name in self.names:
            value = getattr(model, name)
            if self.joint is None:
                off[name] = value * (1.0 + self.share) + self.amount
            else:
                off[name] = tuple(v + self.amount * (i == self.joint) for i, v in enumerate(value))
        return with_model(experiment, **off)


SPRING = "two fits of the same springs differ by this much; the paper's own fit has one pose"
WEIGHED = "of parts that are weighed, but whose rods are shared out between their ends by calculation"
MACHINED = "of machined parts with ball joints"
STOPPED = "of a zero that is set against a mechanical stop"

UNCERTAINTIES = (
    Uncertainty("k_s +2 %", ("k_s",), share=0.02, reason=SPRING),
    # less, because no belt gives back more than it is given
    Uncertainty("eta -2 %", ("eta",), share=-0.02, reason="belts of this kind lose 0 to 4 %"),
    Uncertainty("masses +5 %", ("m_a", "m_b", "m_p"), share=0.05, reason=WEIGHED),
    *(Uncertainty(f"{name} +0.1 mm", (name,), amount=1e-4, reason=MACHINED) for name in ("a", "b", "l_a", "l_b")),
    *(
        Uncertainty(f"zero of {encoder} encoder {joint + 1} +0.05 deg", (name,), joint, amount=radians(0.05),
                    reason=STOPPED)
        for encoder, name in (("motor", "motor_zero"), ("joint", "joint_zero"))
        for joint in range(3)
    ),
)  # fmt: skip
"""What the paper does not print is assumed: Sec. III.A identifies k_s and eta only, and gives no uncertainty."""
