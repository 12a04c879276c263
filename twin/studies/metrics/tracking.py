"""How far a quantity is from where it should be."""

import numpy as np

from twin.studies.metrics.response import Curve


def rms(x: Curve) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def mean_error(y: Curve, reference: Curve | float) -> float:
    """Mean of |y - reference|."""
    return float(np.mean(np.abs(y - reference)))


def level_changes(t: Curve, y: Curve, span: float) -> tuple[Curve, Curve]:
    """(times, changes): the mean of y over `span` (s) after a time less its mean over `span` before it.

    Args:
        t, y: evenly spaced samples, for longer than twice the span (n,).
    """
    steps = round(span / (t[1] - t[0]))
    sums = np.concatenate([[0.0], np.cumsum(y)])
    means = (sums[steps:] - sums[:-steps]) / steps
    changes = means[steps:] - means[:-steps]
    return t[steps : steps + len(changes)], changes


def lag(t: Curve, y: Curve, reference: Curve, longest: float) -> float:
    """Delay (s) from 0 to `longest` that the reference needs to fit y best.

    Where the mean square difference is least over whole samples, and between them at the vertex of the parabola through
    that sample and its neighbours (Jacovitti and Scarano, Discrete time techniques for time delay estimation, IEEE
    Trans. Signal Processing 41, 1993: average square difference function).

    Args:
        t: evenly spaced, for longer than `longest` (n,).
        y, reference: (n,).
    """
    step, n = t[1] - t[0], len(t)
    most = round(longest / step)
    # a sample beyond either end, which the parabola needs
    delays = np.arange(-1, most + 2)
    error = np.array([np.mean((y[most + 1 : n - 1] - reference[most + 1 - k : n - 1 - k]) ** 2) for k in delays])
    best = 1 + int(np.argmin(error[1:-1]))
    before, least, after = error[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    vertex = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(step * np.clip(delays[best] + np.clip(vertex, -0.5, 0.5), 0, most))


def path_error(p: Curve, path: Curve) -> Curve:
    """Distance of each point to a path, whenever it was due there, (n,) in the unit of the points.

    Args:
        p: points (n, d).
        path: corners of the path (m, d), close together where it bends.
    """
    from scipy.spatial import KDTree

    # where the path rests, a corner would have no way to its neighbour
    path = path[np.append(True, np.any(np.diff(path, axis=0) != 0.0, axis=1))]
    _, nearest = KDTree(path).query(p)
    before = _to_segment(p, path[np.maximum(nearest - 1, 0)], path[nearest])
    after = _to_segment(p, path[nearest], path[np.minimum(nearest + 1, len(path) - 1)])
    return np.minimum(before, after)


def _to_segment(p: Curve, a: Curve, b: Curve) -> Curve:
    """Distances (n,) of points to the segments from a to b, each (n, d)."""
    way = b - a
    length2 = np.sum(way**2, axis=1)
    share = np.divide(np.sum((p - a) * way, axis=1), length2, out=np.zeros(len(p)), where=length2 > 0.0)
    return np.linalg.norm(p - a - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1)
