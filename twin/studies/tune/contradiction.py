"""Where the co-simulation does not bear out what the linear model predicts."""

import math

from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import HORIZON, SETTLED, Prediction
from twin.studies.tune.trial import Trial

DOUBT = 0.05
"""Share of a step by which a simulated overshoot may exceed its goal: backlash and counts are not linear."""
SWING = 0.1
"""Peak to peak (share of the step) from which a simulated swing that lasts is told."""
SLOWER = 0.1
"""Share of the bandwidth asked for that the simulated one may lack."""


def contradiction(trial: Trial, prediction: Prediction, goals: Goals) -> str:
    """What the co-simulation does that the linear model does not and that the goals forbid; "" if nothing."""
    simulated, linear = trial.answer, prediction.answers[trial.law]
    if trial.swing > SWING:
        return f"the co-simulation never comes to rest, it swings by {100.0 * trial.swing:.0f} % of the step"
    if simulated.overshoot > goals.overshoot + DOUBT:
        return f"the co-simulation overshoots by {100.0 * simulated.overshoot:.0f} %"
    if math.isinf(simulated.settling) and math.isfinite(linear.settling):
        within = f"within {100.0 * SETTLED:g} % of its end"
        return f"the co-simulation is not {within} after {HORIZON:g} s; predicted are {linear.settling:.2g} s"
    if goals.bandwidth and trial.law == goals.law:
        # a goal that is predicted to be missed is told as such
        expected = min(goals.bandwidth, linear.bandwidth)
        if simulated.bandwidth < (1.0 - SLOWER) * expected:
            return f"the co-simulation has a bandwidth of {simulated.bandwidth / (2.0 * math.pi):.3g} Hz only"
    return ""
