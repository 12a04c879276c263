"""The design from which Sobol' indices are estimated: blocks of two points and of those in between.

A block of d + 2 runs is a row of the matrices A, B, A_B^1 .. A_B^d of Saltelli et al. (2010), "Variance based
sensitivity analysis of model output", Computer Physics Communications 181: A_B^i is A with parameter i of B.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.studies.sweep.vary import Vary


def block_width(dimensions: int) -> int:
    """Runs in a block."""
    return dimensions + 2


def saltelli_cube(blocks: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draws, (blocks * (d + 2), d), block after block, so that a sweep that was interrupted has whole blocks.

    A and B are the two halves of a scrambled Sobol' sequence in 2 d dimensions, as Saltelli et al. advise (Sec. 3).

    Args:
        blocks: a power of 2.
    """
    from scipy.stats import qmc

    A, B = np.split(qmc.Sobol(2 * dimensions, seed=rng).random(blocks), 2, axis=1)
    cube = np.repeat(A[:, None, :], block_width(dimensions), axis=1)
    cube[:, 1] = B
    for i in range(dimensions):
        cube[:, 2 + i, i] = B[:, i]
    return cube.reshape(-1, dimensions)


def why_not_saltelli(tables: Sequence[Vary]) -> list[str]:
    """What in [[vary]] cannot be: the shares of a variance add up only if parameters are independent and all differ."""
    return [
        f'[[vary]] {number}: {key} does not go with design = "saltelli", whose parameters are independent numbers; '
        "remove it, or choose another design"
        for number, vary in enumerate(tables, start=1)
        for key in ("values", "when")
        if getattr(vary, key) is not None
    ]
