"""Plausibility check of a log's columns against its map, and the corrected map.

The motor follows its joint, theta_m = N theta_l + w (19), with w, the deflection of the spring, of some tenths of a
radian. The deflection reveals exchanged columns, opposite signs and degrees, in the first sample and over the whole
log; the correlation with the springs' force reveals a measured force of opposite sign.
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
"""Counts of the motor and joint encoders -> angles that may replace them in a log."""
COUNT_OF_ANGLE = {"theta_m": "encoder.count_m", "theta_l": "encoder.count_l"}
"""Angles of motors and joints -> counts that may replace them in a log."""
MAX_JOINT_ANGLE = 2.0
"""Maximum joint angle of a delta robot from the horizontal (rad)."""
MAX_DEFLECTION = 1.0
"""Maximum deflection of a spring at the start of a log (rad of the motor), five times that at 18 N."""
LIKELY_DEFLECTION = 0.4
"""Maximum deflection with a proposed map (rad of the motor), twice that at 18 N."""
MAP_CORRECTIONS = {
    "as degrees": (1, "deg"), "with the other sign": (-1, ""), "as degrees of the other sign": (-1, "deg"),
}  # fmt: skip
"""Sign and unit by the correction of a map."""
MIN_DEFLECTION_RANGE = 0.1
"""Minimum range of a spring's deflection (rad) that distinguishes columns."""
MIN_IMPROVEMENT = 4.0
"""Minimum factor between that range and the range with a proposed map."""
OPPOSITE_CORRELATION, MIN_FORCE_RANGE = -0.8, 1.0
"""Correlation of measured and estimated force below which signs differ, and the range (N) needed for this test."""


class MapCheck:
    """Plausibility check of angles and force of a log or a live robot, which detects a wrong column map.

    Args:
        where: begins the error messages.
        columns: the map; empty for a recording of twin, which is not checked.
    """

    def __init__(self, where: str, belief: Belief, columns: Mapping[str, MappedColumn]):
        self._where, self._belief, self._columns = where, belief, columns
        self._names = {
            side: counts if f"{counts}[0]" in columns else f"estimator.{side}"
            for side, counts in COUNT_OF_ANGLE.items()
        }
        counted = all(self._names[side] == counts for side, counts in COUNT_OF_ANGLE.items())
        # ratio of the resolutions, for exchanged counts
        self._exchanged = belief.motor_counts / belief.joint_counts if counted else 1.0
        # range of w by (motors and joints exchanged, sign, column of the motor, column of the joint)
        self._low, self._high = np.full((2, 2, 3, 3), np.inf), np.full((2, 2, 3, 3), -np.inf)
        self._sums, self._least, self._most = np.zeros((3, 3)), np.inf, -np.inf

    def check_first(self, count_m: NDArray[np.float64], count_l: NDArray[np.float64], failed: bool) -> str:
        """Return an error message if the first counts (3,) are implausible, in twin's own runs if `failed`; else ""."""
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
            # small angles are poses in any unit
            turned = float(np.max(np.abs(theta_l))) > 2.0 * np.pi
            possible = [way for way, (_, unit) in MAP_CORRECTIONS.items() if turned or not unit]
            ways = [way for way in possible if self._is_pose(_factor(way) * theta_l)]
            return self._sentence(text, "theta_l", ways)
        text = (
            f"{self._where}: the first motor angles ({of_motors}) deg are not those of these joints, {belief.N:g} "
            f"times ({of_joints}) deg"
        )
        wounds = {way: self._largest_deflection(_factor(way) * theta_m, theta_l) for way in MAP_CORRECTIONS}
        ways = sorted((way for way in MAP_CORRECTIONS if wounds[way] <= LIKELY_DEFLECTION), key=wounds.__getitem__)
        return self._sentence(text, "theta_m", ways)

    def add(self, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> None:
        """Add angles of motors and joints (n, 3), rad, to the check of the column map; rows not finite are skipped."""
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
        """Add pressing forces (n,), N, of the springs and of the sensor to the check of the column map."""
        there = np.isfinite(estimated + measured)
        if np.any(there):
            x = np.stack([np.ones(np.sum(there)), estimated[there], measured[there]])
            self._sums += x @ x.T
            self._least, self._most = min(self._least, float(x[2].min())), max(self._most, float(x[2].max()))

    @property
    def map_error(self) -> str:
        """Check the column map against the whole log. Return an error message with the corrected map; "" if it fits."""
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
        map_to_write = self._map({FORCE_SIGNAL: FORCE_SIGNAL}, {FORCE_SIGNAL: -1})
        return (
            f"{self._where}: {FORCE_SIGNAL} has the other sign, its correlation with the force of the springs is "
            f"{xy / np.sqrt(xx * yy):.2f}; a press is positive; {map_to_write}"
        )

    def _corrected_sources(
        self, exchanged: int, order: tuple[int, ...], signs: tuple[int, ...]
    ) -> tuple[dict[str, str], dict[str, int]]:
        """Map each signal to the signal with the right column, and to the change of its sign."""
        motor, joint = (self._names[side] for side in ("theta_m", "theta_l"))
        taken = (joint, motor) if exchanged else (motor, joint)
        sources = {f"{motor}[{leg}]": f"{taken[0]}[{order[leg]}]" for leg in range(3)}
        sources |= {f"{joint}[{leg}]": f"{taken[1]}[{leg}]" for leg in range(3)}
        return sources, {f"{motor}[{leg}]": signs[leg] for leg in range(3)}

    def _map(self, sources: Mapping[str, str], signs: Mapping[str, int], unit: str = "") -> str:
        """Format the corrected column map: other columns and signs, and another unit for the signals in `sources`."""
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
        own = dict(zip(names, names, strict=True))
        return f"{text}; {ways[0]} they do: {self._map(own, dict.fromkeys(names, sign), unit)}"

    def _is_pose(self, theta_l: NDArray[np.float64]) -> bool:
        within = np.max(np.abs(theta_l)) <= MAX_JOINT_ANGLE
        return bool(within and np.all(np.isfinite(platform_position(self._belief, *theta_l))))

    def _largest_deflection(self, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> float:
        """Compute the largest deflection of a spring (rad of its motor) from angles of motors and joints."""
        return float(np.max(np.abs(theta_m - self._belief.N * theta_l)))


def _factor(way: str) -> float:
    sign, unit = MAP_CORRECTIONS[way]
    return sign * (np.pi / 180.0 if unit else 1.0)


def count_conversion(name: str, belief: Belief) -> tuple[tuple[float, float, float], float]:
    """Return offset and gain that convert an encoder's angles to counts: (angle + zero) * counts per rad."""
    of_motor = name == "count_m"
    turn, zero = (belief.motor_counts, belief.motor_zero) if of_motor else (belief.joint_counts, belief.joint_zero)
    return zero, turn / (2.0 * np.pi)
