"""The pre-defined trajectory: way points joined by straight lines at constant speed."""

from numba import njit


@njit(cache=True)
def reference_position(times, points, segment, t):
    """Point (m) of the trajectory at `t` (s), and the segment it lies in.

    Args:
        times: (n,) ascending, s. points: (n, 3), m.
        segment: any index at or before the right one; pass the one returned last.

    Returns:
        (x, y, z, segment). Before the first way point the first, after the last the last.
    """
    last = times.shape[0] - 1
    while segment < last and t >= times[segment + 1]:
        segment += 1
    if segment == last or t <= times[0]:
        return points[segment, 0], points[segment, 1], points[segment, 2], segment
    share = (t - times[segment]) / (times[segment + 1] - times[segment])
    a, b = points[segment], points[segment + 1]
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        segment,
    )
