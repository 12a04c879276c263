"""From a definition to points: what is decided in each run, drive by drive."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.studies.sweep.definition import Definition
from twin.studies.sweep.vary import Value, Vary

MOST = 10_000_000
"""Points that are planned in memory at most."""
_TINY = 2.0**-53
"""Half a unit in the last place of 1: keeps a draw off the ends, where distributions reach to infinity."""


@dataclass(frozen=True)
class Point:
    """One run: the drive (None: the experiment's own) and the values decided, by the label of their [[vary]]."""

    drive: str | None
    parameters: dict[str, Value]


def largest_count(definition: Definition) -> int:
    """How many runs it makes if every condition holds; no point is made for that."""
    if definition.design == "grid":
        points = math.prod(len(vary.values) if vary.values else vary.count or 1 for vary in definition.vary)
    else:
        points = definition.runs or 0
    if definition.design == "saltelli":
        points *= block_width(len(definition.vary))
    return points * max(1, len(definition.drives))


def points(definition: Definition) -> list[Point]:
    """Every run, no two alike. Each drive runs the same points, so that drives can be compared.

    Raises:
        InputRefused: more than fit in memory.
    """
    if (count := largest_count(definition)) > MOST:
        raise InputRefused(f"{count:,} runs: more than {MOST:,} cannot be planned; take fewer levels, or draw")
    cube = None if definition.design == "grid" else unit_cube(definition)
    found: dict[tuple[object, ...], Point] = {}
    drives: list[str | None] = [*definition.drives] or [None]
    for drive in drives:
        start: dict[str, Value] = {} if drive is None else {"drive": drive}
        rows = grid(definition.vary, start) if cube is None else (_drawn(definition.vary, start, u) for u in cube)
        for chosen in rows:
            chosen.pop("drive", None)
            # without the keys that a condition left out, two draws can be the same run
            found.setdefault((drive, *((type(v), k, v) for k, v in chosen.items())), Point(drive, chosen))
    return list(found.values())


def grid(tables: list[Vary], chosen: dict[str, Value]) -> Iterator[dict[str, Value]]:
    """Every combination of levels, the last table varying fastest; one whose condition fails adds none."""
    if not tables:
        yield dict(chosen)
        return
    first, *rest = tables
    if not first.applies(chosen):
        yield from grid(rest, chosen)
        return
    for level in first.levels():
        yield from grid(rest, {**chosen, first.label: level})


def unit_cube(definition: Definition) -> NDArray[np.float64]:
    """Draws of the design, (runs, tables), inside 0 .. 1. Same seed, same draws. Of "saltelli" see `saltelli_cube`.

    Source: scipy.stats.qmc; Latin hypercube after McKay, Beckman and Conover (1979), Sobol' scrambled after Owen.
    """
    rng = np.random.default_rng(definition.seed)
    runs, dimensions = definition.runs or 0, len(definition.vary)
    if definition.design == "random":
        draws = rng.random((runs, dimensions))
    elif definition.design == "saltelli":
        draws = saltelli_cube(runs, dimensions, rng)
    else:
        from scipy.stats import qmc

        engine = (qmc.Sobol if definition.design == "sobol" else qmc.LatinHypercube)(dimensions, seed=rng)
        draws = engine.random(runs)
    return np.clip(draws, _TINY, 1.0 - _TINY)


def _drawn(tables: list[Vary], chosen: dict[str, Value], u: NDArray[np.float64]) -> dict[str, Value]:
    chosen = dict(chosen)
    for vary, share in zip(tables, u, strict=True):
        if vary.applies(chosen):
            chosen[vary.label] = vary.drawn(float(share))
    return chosen


def block_width(dimensions: int) -> int:
    """Runs in a block."""
    return dimensions + 2


def saltelli_cube(blocks: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draws, (blocks * (d + 2), d), from which Sobol' indices are estimated: two points and those in between.

    A block of d + 2 runs is a row of the matrices A, B, A_B^1 .. A_B^d of Saltelli et al. (2010), "Variance based
    sensitivity analysis of model output", Computer Physics Communications 181: A_B^i is A with parameter i of B. Block
    comes after block, so that a sweep that was interrupted has whole blocks. A and B are the two halves of a scrambled
    Sobol' sequence in 2 d dimensions, as Saltelli et al. advise (Sec. 3).

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
