"""What both the maker of a robot and its controller know of it."""

from twin.settings import Settings, Triple, setting


class Model(Settings):
    """What both the robot's maker and its controller know of a robot: Fig. 2, Eq. 18-20, the encoders."""

    a: float = setting("mm", gt=0, help="radius of the base triangle, Fig. 2")
    b: float = setting("mm", gt=0, help="radius of the platform triangle, Fig. 2")
    l_a: float = setting("mm", gt=0, help="length of the proximal links, Fig. 2")
    l_b: float = setting("mm", gt=0, help="length of the distal links, Fig. 2")
    m_a: float = setting("g", ge=0, help="mass of one proximal link")
    m_b: float = setting("g", ge=0, help="mass of one distal rod pair")
    m_p: float = setting("g", ge=0, help="mass of the platform with its head")
    k_s: float = setting("N m/rad", gt=0, help="stiffness of the series elastic spring, Eq. 18")
    N: float = setting(gt=0, help="belt reduction, motor turns per joint turn")
    eta: float = setting(gt=0, le=1, help="efficiency of the belt, Eq. 18")
    motor_counts_per_turn: int = setting(
        gt=0, into="encoders", field="motor_counts", help="resolution of the motor encoders"
    )
    joint_counts_per_turn: int = setting(
        gt=0, into="encoders", field="joint_counts", help="resolution of the joint encoders"
    )
    motor_zero: Triple = setting("deg", into="encoders", help="angle at which each motor encoder reads zero")
    joint_zero: Triple = setting("deg", into="encoders", help="angle at which each joint encoder reads zero")
