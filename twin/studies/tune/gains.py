"""The gains that are tuned: P of the position law, P and I of the force law."""

from dataclasses import replace
from typing import NamedTuple

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment


class LawGains(NamedTuple):
    """Gains, SI.

    Attributes:
        kp: platform speed per position error (1/s).
        force_kp, force_ki: shift of the z reference per force error (m/N), per its integral (m/(N s)).
    """

    kp: float
    force_kp: float
    force_ki: float


def rounded(gains: LawGains) -> LawGains:
    """`gains` with three digits, as they are told and written."""
    return LawGains(*(float(f"{gain:.2e}") for gain in gains))


def gains_of(experiment: Experiment) -> LawGains:
    """The gains that `experiment` has.

    Raises:
        InputRefused: its laws have gains that are not tuned.
    """
    position, force = experiment.controller.position, experiment.controller.force
    others = {
        "controller.position.ki_per_s2": position.ki,
        "controller.position.kd": position.kd,
        "controller.force.kd_mm_s_per_N": force.kd,
    }
    for key, value in others.items():
        if value:
            raise InputRefused(
                f"{experiment.name}: {key} is not 0; only kp of the position law and kp and ki of the force law are "
                f"tuned, so --set {key}=0"
            )
    return LawGains(position.kp, force.kp, force.ki)


def with_gains(experiment: Experiment, gains: LawGains) -> Experiment:
    """The same experiment with other gains; `values` still say what the file does."""
    c = experiment.controller
    position = c.position.model_copy(update={"kp": gains.kp})
    force = c.force.model_copy(update={"kp": gains.force_kp, "ki": gains.force_ki})
    return replace(experiment, controller=c.model_copy(update={"position": position, "force": force}))
