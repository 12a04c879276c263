"""How well a path in the plane follows a circle or a line."""

import numpy as np

from twin.studies.metrics.response import Curve


def fitted_circle(x: Curve, y: Curve) -> tuple[float, float, float]:
    """(x_c, y_c, r) of the circle nearest to the points, in their unit.

    Least squares of x^2 + y^2 = 2 x_c x + 2 y_c y + (r^2 - x_c^2 - y_c^2), linear in the brackets (Kasa 1976). On
    points all round the circle that has no bias; on a short, noisy arc r comes out too small.

    Args:
        x, y: at least three points that are not on a line (n,).
    """
    known = np.column_stack([2.0 * x, 2.0 * y, np.ones_like(x)])
    (x_c, y_c, rest), *_ = np.linalg.lstsq(known, x**2 + y**2, rcond=None)
    return float(x_c), float(y_c), float(np.sqrt(rest + x_c**2 + y_c**2))


def turns_about(x: Curve, y: Curve, centre: tuple[float, float]) -> float:
    """How often the path goes round `centre`, counter-clockwise positive; less than half a turn between two points."""
    angle = np.unwrap(np.arctan2(y - centre[1], x - centre[0]))
    return float(angle[-1] - angle[0]) / (2.0 * np.pi)


def along_and_off(p: Curve, start: tuple[float, float], end: tuple[float, float]) -> tuple[Curve, Curve]:
    """(along, off), each (n,): how far the points (n, 2) are along the line from `start` to `end`, and left of it."""
    direction = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    way = p - np.asarray(start)
    return way @ direction, way @ np.array([-direction[1], direction[0]])
