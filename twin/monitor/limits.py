"""What the monitor tolerates, and how it retracts."""

from typing import NamedTuple

from twin.cosim.record import record_of


class Limits(NamedTuple):
    """Limits of the monitor, SI. A check trips when its limit is reached; docs/safety.md says what each is for.

    Attributes:
        force_limit: length of the low-passed force F_ee_B (N).
        force_rate_limit: how fast that length may grow (N/s).
        contact_force: pressing force at which a contact begins (N); it ends at half of it.
        penetration_limit: platform below the place where the contact began (m).
        contact_time_limit: one contact without a pause (s).
        speed_limit: low-passed speed of the platform (m/s).
        workspace_radius, z_min, z_max: upright cylinder about the z axis of B in which O_P has to stay (m).
        deflection_limit: wind-up of a spring, motor side (rad).
        jump_limit: motor, joint and wind-up, all on the motor's side, from one sample to the next (rad/s).
        stale_time: how far the sample counter may be off the time that has passed (s).
        frozen_demand: commanded speed (rad/s) above which a motor encoder has to move, within `frozen_time` (s).
        frozen_travel: motor angle (rad) within which the joint has to move a count.
        command_limit: commanded motor speed that counts as saturated (rad/s).
        saturation_time: for how long (s).
        follow_limit: how far a motor's low-passed speed may be off the command's (rad/s).
        follow_time: how long (s).
        filter: corner of the first-order low-pass on force and speeds (Hz).
        retract: motor angle of the retraction (rad).
        retract_speed: its speed (rad/s).
    """

    force_limit: float
    force_rate_limit: float
    contact_force: float
    penetration_limit: float
    contact_time_limit: float
    speed_limit: float
    workspace_radius: float
    z_min: float
    z_max: float
    deflection_limit: float
    jump_limit: float
    stale_time: float
    frozen_demand: float
    frozen_time: float
    frozen_travel: float
    command_limit: float
    saturation_time: float
    follow_limit: float
    follow_time: float
    filter: float
    retract: float
    retract_speed: float


LIMITS = record_of(Limits)
