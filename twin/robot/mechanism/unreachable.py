"""Error for poses and joint angles outside the mechanism's reach."""

from twin.kernel.errors import InputRefused


class Unreachable(InputRefused, ValueError):
    """Error for a platform position or joint angles outside the mechanism's reach.

    Attributes:
        leg: 1, 2 or 3, the leg that cannot follow; 0 if it is not a single leg.
        pose: requested platform position (m) or joint angles (rad).
        excess: distance from reach, in m (always positive).
    """

    def __init__(self, message: str, leg: int, pose: tuple[float, ...], excess: float):
        super().__init__(message)
        self.leg = leg
        self.pose = pose
        self.excess = excess
