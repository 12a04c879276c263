"""How alike repetitions of the same thing are."""

import numpy as np

from twin.studies.metrics.response import Curve


def variation(x: Curve) -> float:
    """Coefficient of variation: standard deviation over mean of the sample (n,)."""
    return float(np.std(x) / np.mean(x))
