"""How far a quantity is from where it should be."""

import numpy as np
from scipy.spatial import KDTree

from twin.metrics.response import Curve


def rms(x: Curve) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def mean_error(y: Curve, reference: Curve | float) -> float:
    """Mean of |y - reference|."""
    return float(np.mean(np.abs(y - reference)))


def bump(t: Curve, y: Curve) -> tuple[float, float]:
    """(time, size) of the largest deviation of y from a cubic fitted to it: a fluctuation on a slow trend."""
    middle = 0.5 * (t[0] + t[-1])
    rest = y - np.polyval(np.polyfit(t - middle, y, 3), t - middle)
    worst = int(np.argmax(np.abs(rest)))
    return float(t[worst]), float(abs(rest[worst]))


def lag(t: Curve, y: Curve, reference: Curve, longest: float) -> float:
    """Delay (s), at most `longest`, that the reference needs to fit y best: least squares over whole samples.

    Args:
        t: evenly spaced (n,). y, reference: (n,).
    """
    step = t[1] - t[0]
    most = min(round(longest / step), len(t) // 2)
    errors = [np.mean((y[most:] - reference[most - k : len(t) - k]) ** 2) for k in range(most + 1)]
    return float(step * int(np.argmin(errors)))


def path_error(p: Curve, path: Curve) -> Curve:
    """Distance of each point to a path, whenever it was due there, (n,) in the unit of the points.

    Args:
        p: points (n, d). path: corners of the path (m, d), close together where it bends.
    """
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
