"""Whether the columns of a log are the signals that its map says, and the map to write if they are not.

A motor turns with its joint, theta_m = N theta_l + w (19), and the spring between them is wound by w: some tenths of a
radian. Columns that are exchanged, of the other sign or in degrees are found by what they make of w, in the first
sample and over the whole course; a force of the other sign by its correlation with that of the springs.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.column_map import TIME_SIGNAL, map_text
from twin.kernel.recording.logs.log import MappedColumn
from twin.robot.controller.controller import Belief, angle
from twin.robot.mechanism.kinematics import platform_position

FORCE_SIGNAL = "scale.F_z"
ANGLE_OF_COUNT = {"count_m": "theta_m", "count_l": "theta_l"}
"""The counts of the motor and joint encoders, and the angles that a log may have in their place."""
COUNT_OF_ANGLE = {"theta_m": "encoder.count_m", "theta_l": "encoder.count_l"}
"""The angles of motors and joints, and the signals that a log may have in their place."""
MAX_JOINT_ANGLE = 2.0
"""rad. No joint of a delta robot turns further from the horizontal."""
MAX_DEFLECTION = 1.0
"""rad of a motor, by which a spring is wound at most where a log begins: five times what it is at a force of 18 N."""
LIKELY_DEFLECTION = 0.4
"""The same of angles that something is to be proposed for: twice that at 18 N."""
MAP_CORRECTIONS = {"[deg]": (1, "deg"), "-": (-1, ""), "- and [deg]": (-1, "deg")}
"""Sign and unit that may have been left out of a map."""
MIN_DEFLECTION_RANGE = 0.1
"""Smallest range of a spring's deflection (rad) that can tell one column from another."""
MIN_IMPROVEMENT = 4.0
"""Factor by which another map must make that range smaller to be proposed."""
OPPOSITE_CORRELATION, MIN_FORCE_RANGE = -0.8, 1.0
"""Correlation of measured and estimated force below which the measured one has the other sign, and the smallest range
of the measured one (N) that tells."""


class MapCheck:
    """A check of the angles and the force of a log, or of a robot that is followed.

    Args:
        where: begins the error messages.
        belief: geometry, N, counts of the encoders.
        columns: the map; empty for a recording of twin, whose course is not checked.
    """

    def __init__(self, where: str, belief: Belief, columns: Mapping[str, MappedColumn]):
        self._where, self._belief, self._columns = where, belief, columns
        self._names = {
            side: counts if f"{counts}[0]" in columns else f"estimator.{side}"
            for side, counts in COUNT_OF_ANGLE.items()
        }
        counted = all(self._names[side] == counts for side, counts in COUNT_OF_ANGLE.items())
        # counts of one encoder read with the resolution of the other
        self._exchanged = belief.motor_counts / belief.joint_counts if counted else 1.0
        # of w by (motors and joints exchanged, sign, column of the motor, column of the joint)
        self._low, self._high = np.full((2, 2, 3, 3), np.inf), np.full((2, 2, 3, 3), -np.inf)
        self._sums, self._least, self._most = np.zeros((3, 3)), np.inf, -np.inf

    def check_first(self, count_m: NDArray[np.float64], count_l: NDArray[np.float64], failed: bool) -> str:
        """Return why the first counts (3,) of motors and joints cannot be of the robot; "" if they can.

        A recording of twin is checked only if the estimator `failed` on them.
        """
        if not (failed or self._columns):
            return ""
        belief = self._belief
        theta_m = np.array([angle(count_m[i], belief.motor_counts, belief.motor_zero[i]) for i in range(3)])
        theta_l = np.array([angle(count_l[i], belief.joint_counts, belief.joint_zero[i]) for i in range(3)])
        ratio = self._exchanged
        of_motors, of_joints = (", ".join(f"{x:.1f}" for x in np.degrees(one)) for one in (theta_m, theta_l))
        wound = self._largest_deflection(theta_m, theta_l)
        exchanged = (
            self._largest_deflection(theta_l / ratio, theta_m * ratio) if self._is_pose(theta_m * ratio) else np.inf
        )
        if self._is_pose(theta_l) and (
            wound <= LIKELY_DEFLECTION or (wound <= MAX_DEFLECTION and MIN_IMPROVEMENT * exchanged > wound)
        ):
            return ""
        if exchanged <= LIKELY_DEFLECTION and MIN_IMPROVEMENT * exchanged < wound:
            text = f"{self._where}: motors and joints are exchanged: ({of_joints}) deg are the motors' angles"
            return f"{text}; {self._map(*self._corrected_sources(1, (0, 1, 2), (1, 1, 1)))}"
        if not self._is_pose(theta_l):
            text = f"{self._where}: the first joint angles ({of_joints}) deg fit no pose of the robot"
            # small angles are poses, whatever they were meant to be
            turned = float(np.max(np.abs(theta_l))) > 2.0 * np.pi
            ways = [
                way for way in MAP_CORRECTIONS if (turned or "deg" not in way) and self._is_pose(_factor(way) * theta_l)
            ]
            return self._sentence(text, "theta_l", ways)
        text = (
            f"{self._where}: the first motor angles ({of_motors}) deg are not those of these joints, {belief.N:g} "
            f"times ({of_joints}) deg"
        )
        wounds = {way: self._largest_deflection(_factor(way) * theta_m, theta_l) for way in MAP_CORRECTIONS}
        ways = sorted((way for way in MAP_CORRECTIONS if wounds[way] <= LIKELY_DEFLECTION), key=wounds.__getitem__)
        return self._sentence(text, "theta_m", ways)

    def add(self, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> None:
        """Add angles of motors and joints (n, 3), rad; those that are not finite are left out."""
        there = np.isfinite(theta_m + theta_l).all(axis=1)
        if not np.any(there):
            return
        motors, joints = theta_m[there], theta_l[there]
        pairs = (motors, joints), (joints / self._exchanged, motors * self._exchanged)
        for exchanged, (motor, joint) in enumerate(pairs):
            for sign in (0, 1):
                w = motor[:, :, None] - (1 - 2 * sign) * self._belief.N * joint[:, None, :]
                place = exchanged, sign
                self._low[place] = np.minimum(self._low[place], w.min(axis=0))
                self._high[place] = np.maximum(self._high[place], w.max(axis=0))

    def add_force(self, estimated: NDArray[np.float64], measured: NDArray[np.float64]) -> None:
        """Add pressing forces (n,), N, by the springs and by the sensor."""
        there = np.isfinite(estimated + measured)
        if np.any(there):
            x = np.stack([np.ones(np.sum(there)), estimated[there], measured[there]])
            self._sums += x @ x.T
            self._least, self._most = min(self._least, float(x[2].min())), max(self._most, float(x[2].max()))

    @property
    def map_error(self) -> str:
        """What the whole course says against the map, with the map to write; "" if nothing."""
        if not self._columns:
            return ""
        return self._angles_error() or self._force_error()

    def _angles_error(self) -> str:
        span = self._high - self._low
        given = float(np.max(np.diagonal(span[0, 0])))
        if not MIN_DEFLECTION_RANGE < given < np.inf:
            return ""
        best = np.inf
        choice: tuple[int, tuple[int, ...], tuple[int, ...]] = (0, (0, 1, 2), (1, 1, 1))
        for exchanged in (0, 1):
            for order in permutations(range(3)):
                of_leg = span[exchanged, :, order, range(3)]
                if (worst := float(of_leg.min(axis=1).max())) < best:
                    signs = tuple(1 - 2 * int(sign) for sign in of_leg.argmin(axis=1))
                    best, choice = worst, (exchanged, order, signs)
        if best > LIKELY_DEFLECTION or MIN_IMPROVEMENT * best > given:
            return ""
        exchanged, order, signs = choice
        what = ["motors and joints are exchanged"] if exchanged else []
        what += ["columns of the legs are exchanged"] if order != (0, 1, 2) else []
        legs = [str(leg + 1) for leg, sign in enumerate(signs) if sign < 0]
        what += [f"motor and joint {', '.join(legs)} turn in opposite senses"] if legs else []
        return (
            f"{self._where}: {', and '.join(what)}: a spring is wound by {np.degrees(given):.0f} deg as the map has "
            f"it, by {np.degrees(best):.1f} deg otherwise; {self._map(*self._corrected_sources(*choice))}"
        )

    def _force_error(self) -> str:
        n, x, y = self._sums[0]
        xx, xy, yy = n * self._sums[1, 1] - x * x, n * self._sums[1, 2] - x * y, n * self._sums[2, 2] - y * y
        if self._most - self._least < MIN_FORCE_RANGE or xx <= 0.0 or xy > OPPOSITE_CORRELATION * np.sqrt(xx * yy):
            return ""
        return (
            f"{self._where}: {FORCE_SIGNAL} has the other sign, its correlation with the force of the springs is "
            f"{xy / np.sqrt(xx * yy):.2f}; a press is positive; {self._map({FORCE_SIGNAL: FORCE_SIGNAL}, {FORCE_SIGNAL: -1})}"
        )

    def _corrected_sources(
        self, exchanged: int, order: tuple[int, ...], signs: tuple[int, ...]
    ) -> tuple[dict[str, str], dict[str, int]]:
        """Signal -> signal whose column it should have, and by what its sign changes."""
        motor, joint = (self._names[side] for side in ("theta_m", "theta_l"))
        taken = (joint, motor) if exchanged else (motor, joint)
        sources = {f"{motor}[{leg}]": f"{taken[0]}[{order[leg]}]" for leg in range(3)}
        sources |= {f"{joint}[{leg}]": f"{taken[1]}[{leg}]" for leg in range(3)}
        return sources, {f"{motor}[{leg}]": signs[leg] for leg in range(3)}

    def _map(self, sources: Mapping[str, str], signs: Mapping[str, int], unit: str = "") -> str:
        """The map to write: that of the log with other columns and signs, and another unit for those in `sources`."""
        own = [f"{self._names[side]}[{leg}]" for side in COUNT_OF_ANGLE for leg in range(3)]
        lines = []
        for name in [one for one in (TIME_SIGNAL, *own, FORCE_SIGNAL) if one in self._columns] or list(sources):
            column = self._columns.get(sources.get(name, name), MappedColumn("COLUMN"))
            changed = replace(column, sign=column.sign * signs.get(name, 1))
            lines.append(map_text(name, replace(changed, unit=unit) if unit and name in sources else changed))
        return "write in the map:\n" + "\n".join(lines)

    def _sentence(self, text: str, side: str, ways: list[str]) -> str:
        if not ways:
            return f"{text}; are their signs, units and zeros those of the experiment?"
        names = [f"{self._names[side]}[{leg}]" for leg in range(3)]
        sign, unit = MAP_CORRECTIONS[ways[0]]
        what = {"[deg]": "as degrees", "-": "with the other sign", "- and [deg]": "as degrees of the other sign"}
        own = dict(zip(names, names, strict=True))
        return f"{text}; {what[ways[0]]} they do: {self._map(own, dict.fromkeys(names, sign), unit)}"

    def _is_pose(self, theta_l: NDArray[np.float64]) -> bool:
        within = np.max(np.abs(theta_l)) <= MAX_JOINT_ANGLE
        return bool(within and np.all(np.isfinite(platform_position(self._belief, *theta_l))))

    def _largest_deflection(self, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> float:
        """The largest angle by which a spring is wound, rad of its motor."""
        return float(np.max(np.abs(theta_m - self._belief.N * theta_l)))


def _factor(way: str) -> float:
    """What angles have to be multiplied by."""
    sign, unit = MAP_CORRECTIONS[way]
    return sign * (np.pi / 180.0 if unit else 1.0)


def count_conversion(name: str, belief: Belief) -> tuple[tuple[float, float, float], float]:
    """What makes counts of angles: (angle + zero of its encoder) * counts per rad, for a name of `ANGLE_OF_COUNT`."""
    of_motor = name == "count_m"
    turn, zero = (belief.motor_counts, belief.motor_zero) if of_motor else (belief.joint_counts, belief.joint_zero)
    return zero, turn / (2.0 * np.pi)
