"""Sobol' indices and intervals of a probability beside published values and scipy's."""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from validation.yardstick import Yardstick

Numbers = NDArray[np.float64]

BLOCKS, SEED = 2**14, 16
FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)
"""Of Ishigami's function with a = 7, b = 0.1, as they are printed in many places, with these digits."""
NEWCOMBE = {(81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0.0, 0.1611), (1, 29): (0.0061, 0.1718)}
"""Successes and trials, and what Wilson's method without correction gives: method 3 of Newcombe's Table I, which was
read in tests of public packages that cite it, four of which agree in all of these numbers."""


@cache
def values() -> tuple[Numbers, Numbers, Numbers]:
    """Ishigami's function at the twin's design: f_A (n,), f_B (n,), f_AB (d, n)."""
    from twin.studies.sweep.plan import saltelli_cube

    x = np.pi * (2.0 * saltelli_cube(BLOCKS, 3, np.random.default_rng(SEED)) - 1.0).reshape(BLOCKS, 5, 3)
    f = np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])
    return f[:, 0], f[:, 1], f[:, 2:].T


def named(first: Numbers, total: Numbers) -> Mapping[str, float]:
    return {
        f"{name} of x{i + 1}": float(off[i]) for name, off in (("first", first), ("total", total)) for i in range(3)
    }


def beside_published() -> Mapping[str, float]:
    from twin.studies.sweep.statistics.sensitivity import estimates

    first, total = estimates(*values())
    return named(np.abs(first - FIRST), np.abs(total - TOTAL))


def beside_scipy() -> Mapping[str, float]:
    from scipy.stats import sobol_indices

    from twin.studies.sweep.statistics.sensitivity import estimates

    f_A, f_B, f_AB = values()
    theirs = sobol_indices(func={"f_A": f_A[None], "f_B": f_B[None], "f_AB": f_AB[:, None]}, n=BLOCKS)
    first, total = estimates(f_A, f_B, f_AB)
    return named(np.abs(first - theirs.first_order), np.abs(total - theirs.total_order))


def beside_newcombe() -> Mapping[str, float]:
    from twin.studies.sweep.statistics.ranking import wilson_interval

    return {
        f"{k} of {n}, {end}": 1e4 * abs(ours - printed)
        for (k, n), ends in NEWCOMBE.items()
        for end, ours, printed in zip(("low", "high"), wilson_interval(k, n), ends, strict=True)
    }


YARDSTICKS = (
    Yardstick(
        f"Sobol indices of Ishigami's function from {BLOCKS} blocks of the twin's design",
        "Ishigami and Homma, 1990; closed form in Saltelli et al., Global Sensitivity Analysis, 2008",
        "of the variance",
        0.01,
        "an estimate's error goes with the root of the blocks: 0.03 is allowed to 2048 of them, and eight times as "
        "many leave a third",
        beside_published,
    ),
    Yardstick(
        "estimates of Sobol indices from the same values of the function",
        "scipy.stats.sobol_indices",
        "of the variance",
        1e-12,
        "the same two estimators, rounding",
        beside_scipy,
        ("scipy",),
    ),
    Yardstick(
        "Wilson's interval of a probability, which the twin leaves to scipy, for four pairs of counts",
        "Newcombe, Two-sided confidence intervals for the single proportion, Stat Med 17:857, 1998, Table I",
        "of the last digit",
        0.501,
        "half of the last digit that is printed",
        beside_newcombe,
    ),
)
