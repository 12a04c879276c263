"""The error for poses and joint angles that the mechanism cannot have."""

from twin.kernel.errors import InputRefused


class Unreachable(InputRefused, ValueError):
    """No pose or no joint angles exist for what was asked.

    Attributes:
        leg: 1, 2 or 3, the leg that cannot follow; 0 where no single leg is to blame.
        pose: what was asked, platform position (m) or joint angles (rad).
        excess: how far out it is, in m (always positive).
    """

    def __init__(self, message: str, leg: int, pose: tuple[float, ...], excess: float):
        super().__init__(message)
        self.leg = leg
        self.pose = pose
        self.excess = excess
